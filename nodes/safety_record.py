"""The last second of what the safety node has heard, for the record of a trip."""

from __future__ import annotations

from collections import deque

import numpy as np

from msgs.safety import LoadReport, RingReport, StageReport, Trip
from palp_core.units import Float64Array

__all__ = ["LastSecond"]

KEEP_NS = 1_000_000_000
Rows = deque[tuple[float, ...]]


class LastSecond:
    """Remember loads, places and ring positions for a second."""

    def __init__(self) -> None:
        self._loads: Rows = deque()
        self._places: Rows = deque()
        self._rings: Rows = deque()

    def load(self, report: LoadReport) -> None:
        """Remember a load, if there is a sample behind it."""
        if report.sample_count:
            _keep(self._loads, (report.sample_ns, report.torque_n_m, report.force_n))

    def stage(self, report: StageReport) -> None:
        """Remember a place."""
        _keep(self._places, (report.stamp_ns, report.y_m, report.z_m))

    def ring(self, report: RingReport) -> None:
        """Remember a ring position."""
        _keep(self._rings, (report.stamp_ns, report.ring_m))

    def trip(
        self, now_ns: int, cause: str, text: str, *, cause_ns: int, written_ns: int, disabled_ns: int
    ) -> Trip:
        """Return the record of a trip."""
        loads, places, rings = _table(self._loads, 3), _table(self._places, 3), _table(self._rings, 2)
        return Trip(
            stamp_ns=now_ns,
            cause=cause,
            text=text,
            cause_ns=cause_ns,
            written_ns=written_ns,
            disabled_ns=disabled_ns,
            load_time_s=(loads[:, 0] - now_ns) * 1e-9,
            torque_n_m=loads[:, 1],
            force_n=loads[:, 2],
            stage_time_s=(places[:, 0] - now_ns) * 1e-9,
            y_m=places[:, 1],
            z_m=places[:, 2],
            ring_time_s=(rings[:, 0] - now_ns) * 1e-9,
            ring_m=rings[:, 1],
        )


def _keep(rows: Rows, row: tuple[float, ...]) -> None:
    rows.append(row)
    while rows[0][0] < row[0] - KEEP_NS:
        rows.popleft()


def _table(rows: Rows, width: int) -> Float64Array:
    return np.array(rows, dtype=np.float64).reshape(-1, width)
