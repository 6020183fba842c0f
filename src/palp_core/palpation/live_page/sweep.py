"""The torque of a sweep against the stage's position, put together from two streams that come apart."""

from __future__ import annotations

from typing import Any

import numpy as np

from palp_core.units import Float64Array

KEPT_S = 10.0
"""Torque whose position is not known yet is kept so long: positions of a real stage come later."""

Point = tuple[float, float]
"""Position in mm, torque in N mm."""


class SweepTrace:
    """The sweep under way: every torque sample that came while the stage was over the phantom.

    Attributes:
        number: Which sweep it is; another one begins with no points.
        position_m: Where the stage was last; None before it said so.
        points: All of this sweep so far.
    """

    def __init__(self) -> None:
        self.number = 0
        self.position_m: float | None = None
        self.points: list[Point] = []
        self._goal: int | None = None
        self._times_ns, self._places_m = np.zeros(0), np.zeros(0)
        self._waiting: list[tuple[Float64Array, Float64Array]] = []

    def pose(self, message: dict[str, Any]) -> None:
        """Take a ``StagePose``."""
        if message["goal_id"] != self._goal:
            self._goal = message["goal_id"]
            self.number += 1
            self.points = []
            self._times_ns, self._places_m = np.zeros(0), np.zeros(0)
        places_m = np.asarray(message["position_m"], dtype=np.float64)
        if len(places_m):
            self._times_ns = np.concatenate([self._times_ns, _times_ns(message, len(places_m))])
            self._places_m = np.concatenate([self._places_m, places_m])
            self.position_m = float(places_m[-1])

    def torque(self, message: dict[str, Any]) -> None:
        """Take a ``TorqueBlock``."""
        torque_n_m = np.asarray(message["torque_n_m"], dtype=np.float64)
        if len(torque_n_m):
            self._waiting.append((_times_ns(message, len(torque_n_m)), torque_n_m))

    def new_points(self) -> list[Point]:
        """Return the points that are new since the last call; of a new sweep all."""
        if not self._waiting:
            return []
        times_ns = np.concatenate([times for times, _ in self._waiting])
        torque_n_m = np.concatenate([torque for _, torque in self._waiting])
        newest_ns = times_ns[-1]
        if not len(self._times_ns):
            kept, found = times_ns > newest_ns - KEPT_S * 1e9, []
        else:
            known = (times_ns >= self._times_ns[0]) & (times_ns <= self._times_ns[-1])
            kept = (times_ns > self._times_ns[-1]) & (times_ns > newest_ns - KEPT_S * 1e9)
            places_mm = 1e3 * np.interp(times_ns[known], self._times_ns, self._places_m)
            found = list(zip(places_mm.tolist(), (1e3 * torque_n_m[known]).tolist(), strict=True))
        self._waiting = [(times_ns[kept], torque_n_m[kept])] if kept.any() else []
        self.points += found
        return found


def whole_sweep(torque_n_m: list[float], from_m: float, to_m: float) -> list[Point]:
    """Return the points of a sweep that is over, at constant speed from one end of the path to the other."""
    places_mm = 1e3 * np.linspace(from_m, to_m, len(torque_n_m))
    return list(zip(places_mm.tolist(), (1e3 * np.asarray(torque_n_m)).tolist(), strict=True))


def _times_ns(message: dict[str, Any], count: int) -> Float64Array:
    times_ns: Float64Array = message["start_ns"] + np.arange(count) * (1e9 / message["rate_hz"])
    return times_ns
