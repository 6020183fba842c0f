"""The last second of what the safety node has heard, for the record of a trip."""

from __future__ import annotations

from collections import deque

import numpy as np

from msgs.safety import LoadReport, RingReport, StageReport, Trip
from palp_core.units import Float64Array

KEEP_NS = 1_000_000_000


class Rows(deque[tuple[int, tuple[float, ...]]]):
    """What was said within a second, by when it was said: a sample may be stamped with any nonsense."""

    def add(self, said_ns: int, *row: float) -> None:
        """Remember a row and forget what is too old."""
        self.append((said_ns, row))
        while self[0][0] < said_ns - KEEP_NS:
            self.popleft()

    def table(self, width: int) -> Float64Array:
        """Return the rows, shape (n, width)."""
        return np.array([row for _, row in self], dtype=np.float64).reshape(-1, width)


class LastSecond:
    """Remember loads, places and ring positions for a second."""

    def __init__(self) -> None:
        self._loads, self._places, self._rings = Rows(), Rows(), Rows()

    def add_load(self, report: LoadReport) -> None:
        """Remember a load, if there is a sample behind it."""
        if report.sample_count:
            self._loads.add(report.stamp_ns, report.sample_ns, report.torque_n_m, report.force_n)

    def add_stage(self, report: StageReport) -> None:
        """Remember a place."""
        self._places.add(report.stamp_ns, report.stamp_ns, report.y_m, report.z_m)

    def add_ring(self, report: RingReport) -> None:
        """Remember a ring position."""
        self._rings.add(report.stamp_ns, report.stamp_ns, report.ring_m)

    def trip(
        self, now_ns: int, cause: str, text: str, *, cause_ns: int, written_ns: int, disabled_ns: int
    ) -> Trip:
        """Return the record of a trip."""
        loads, places, rings = self._loads.table(3), self._places.table(3), self._rings.table(2)
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
