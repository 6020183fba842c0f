"""What training taught, as bands of torque: mean and spread of its sweeps by depth, ring and position."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.session.trials_csv import read_rows, read_sweep
from palp_core.units import Float64Array

PLACES = 161
"""Positions of a band: one each half a millimetre of the published path."""
SPREADS = 2.0
"""Standard deviations on either side: what about 95 % of readings stay within."""


class Band(msgspec.Struct, frozen=True):
    """What a depth feels like at a ring position.

    Attributes:
        depth_mm: The depth.
        sweep_count: How many sweeps it is of.
        places_mm: Where, shape (n,).
        low_n_mm: Mean less two standard deviations.
        high_n_mm: Mean and two standard deviations.
    """

    depth_mm: float
    sweep_count: int
    places_mm: list[float]
    low_n_mm: list[float]
    high_n_mm: list[float]


@dataclass
class _Cell:
    """Count, mean and sum of squares (Welford) of one depth and ring position."""

    count: int
    mean: Float64Array
    squares: Float64Array


class TaughtSweeps:
    """The sweeps of training, summed up as they come."""

    def __init__(self, from_m: float, to_m: float) -> None:
        self._places_mm = (1e3 * np.linspace(from_m, to_m, PLACES)).tolist()
        self._cells: dict[tuple[float, float], _Cell] = {}

    def add(self, depth_m: float, ring_m: float, torque_n_m: Sequence[float] | Float64Array) -> None:
        """Add a sweep of a known depth, at constant speed from one end of the path to the other."""
        torque_n_m = np.asarray(torque_n_m, dtype=np.float64)
        if len(torque_n_m) < 2:
            return
        share = np.linspace(0.0, 1.0, PLACES)
        felt = 1e3 * np.interp(share, np.linspace(0.0, 1.0, len(torque_n_m)), torque_n_m)
        key = (round(depth_m, 6), round(ring_m, 6))
        cell = self._cells.setdefault(key, _Cell(0, np.zeros(PLACES), np.zeros(PLACES)))
        cell.count += 1
        off = felt - cell.mean
        cell.mean += off / cell.count
        cell.squares += off * (felt - cell.mean)

    @property
    def sweep_count(self) -> int:
        return sum(cell.count for cell in self._cells.values())

    def bands(self, ring_m: float) -> list[Band]:
        """Return the band of each depth at the nearest ring position of training, the shallowest first."""
        rings = {ring for _, ring in self._cells}
        if not rings:
            return []
        nearest = min(rings, key=lambda one: abs(one - ring_m))
        found = []
        for (depth_m, ring), cell in sorted(self._cells.items()):
            if ring == nearest and cell.count > 1:
                spread = SPREADS * np.sqrt(cell.squares / (cell.count - 1))
                low, high = (cell.mean - spread).round(3).tolist(), (cell.mean + spread).round(3).tolist()
                found.append(Band(depth_m * 1e3, cell.count, self._places_mm, low, high))
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
    """Return what a session's folder says that its training taught; nothing where there is none."""
    found = TaughtSweeps(from_m, to_m)
    try:
        for row in read_rows(folder):
            if row.phase == "training":
                found.add(row.depth_m, row.ring_m, read_sweep(folder, row.row)[0])
    except PalpError:  # a folder that is elsewhere, or is being replaced: the peaks' bands remain
        return TaughtSweeps(from_m, to_m)
    return found
