"""Torque against position: the sweep under way, from two streams, and the bands that training taught."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.session.trials_csv import read_rows, read_sweep
from palp_core.units import Float64Array

KEPT_S = 10.0
"""Torque without a position waits so long: the positions of a real stage come later."""
PLACES = 161
"""Positions of a band: one each half a millimetre of the published path."""
SPREADS = 2.0
"""Standard deviations on either side: what about 95 % of readings stay within."""

Point = tuple[float, float]
"""Position in mm, torque in N mm."""


class SweepTrace:
    """The torque samples of the sweep under way that came while the stage was over the phantom."""

    def __init__(self) -> None:
        self.number = 0
        self.position_m: float | None = None
        self.points: list[Point] = []
        self._goal: int | None = None
        self._times_ns, self._places_m = np.zeros(0), np.zeros(0)
        self._waiting: list[tuple[Float64Array, Float64Array]] = []

    def pose(self, message: dict[str, Any]) -> None:
        """Take a ``StagePose``; another goal is another sweep, which begins with no points."""
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
        recent = times_ns > times_ns[-1] - KEPT_S * 1e9
        if not len(self._times_ns):
            kept, found = recent, []
        else:
            known = (times_ns >= self._times_ns[0]) & (times_ns <= self._times_ns[-1])
            kept = (times_ns > self._times_ns[-1]) & recent
            places_mm = 1e3 * np.interp(times_ns[known], self._times_ns, self._places_m)
            found = list(zip(places_mm.tolist(), (1e3 * torque_n_m[known]).tolist(), strict=True))
        self._waiting = [(times_ns[kept], torque_n_m[kept])] if kept.any() else []
        self.points += found
        return found


def whole_sweep(torque_n_m: list[float], from_m: float, to_m: float) -> list[Point]:
    """Return the points of a finished sweep, at constant speed from one end of the path to the other."""
    places_mm = 1e3 * np.linspace(from_m, to_m, len(torque_n_m))
    return list(zip(places_mm.tolist(), (1e3 * np.asarray(torque_n_m)).tolist(), strict=True))


def _times_ns(message: dict[str, Any], count: int) -> Float64Array:
    times_ns: Float64Array = message["start_ns"] + np.arange(count) * (1e9 / message["rate_hz"])
    return times_ns


class Band(msgspec.Struct, frozen=True):
    """Mean less and plus two standard deviations of a depth's sweeps at a ring position, mm and N mm."""

    depth_mm: float
    sweep_count: int
    places_mm: list[float]
    low_n_mm: list[float]
    high_n_mm: list[float]


class TaughtSweeps:
    """The sweeps of training, by depth and ring position."""

    def __init__(self, from_m: float, to_m: float) -> None:
        self._places_mm = (1e3 * np.linspace(from_m, to_m, PLACES)).tolist()
        self._sweeps: dict[tuple[float, float], list[Float64Array]] = {}

    def add(self, depth_m: float, ring_m: float, torque_n_m: Sequence[float] | Float64Array) -> None:
        """Add a sweep of a known depth, at constant speed from one end of the path to the other."""
        torque_n_m = np.asarray(torque_n_m, dtype=np.float64)
        if len(torque_n_m) >= 2:
            share = np.linspace(0.0, 1.0, PLACES)
            felt = 1e3 * np.interp(share, np.linspace(0.0, 1.0, len(torque_n_m)), torque_n_m)
            self._sweeps.setdefault((round(depth_m, 6), round(ring_m, 6)), []).append(felt)

    @property
    def sweep_count(self) -> int:
        return sum(map(len, self._sweeps.values()))

    def bands(self, ring_m: float) -> list[Band]:
        """Return the band of each depth at the nearest ring position of training, the shallowest first."""
        nearest = min((ring for _, ring in self._sweeps), key=lambda one: abs(one - ring_m), default=0.0)
        found = []
        for (depth_m, ring), sweeps in sorted(self._sweeps.items()):
            if ring == nearest and len(sweeps) > 1:
                mean, spread = np.mean(sweeps, axis=0), SPREADS * np.std(sweeps, axis=0, ddof=1)
                low, high = (mean - spread).round(3).tolist(), (mean + spread).round(3).tolist()
                found.append(Band(depth_m * 1e3, len(sweeps), self._places_mm, low, high))
        return found


def taught_by_messages(
    trials: Iterable[dict[str, Any]], palpations: Iterable[dict[str, Any]], from_m: float, to_m: float
) -> TaughtSweeps:
    """Return what a bag's ``Trial`` and ``Palpation`` messages taught."""
    depth_m = {trial["trial"]: trial["depth_m"] for trial in trials if trial.get("label_known")}
    found = TaughtSweeps(from_m, to_m)
    for palpation in palpations:
        if palpation["trial"] in depth_m:
            found.add(depth_m[palpation["trial"]], palpation["ring_m"], palpation["torque_n_m"])
    return found


def taught_by_folder(folder: Path, from_m: float, to_m: float) -> TaughtSweeps:
    """Return what training taught by a session's folder; nothing where there is none."""
    found = TaughtSweeps(from_m, to_m)
    try:
        for row in read_rows(folder):
            if row.phase == "training":
                found.add(row.depth_m, row.ring_m, read_sweep(folder, row.row)[0])
    except PalpError:  # the folder is elsewhere, or is being replaced
        return TaughtSweeps(from_m, to_m)
    return found
