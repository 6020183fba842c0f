"""Where two axes were at the polls, and from that where they were in between and when they passed a place."""

from collections import deque

import numpy as np

from palp_core.errors import DeviceError, DeviceTimeout
from palp_core.palpation.devices.protocols import Int64Array
from palp_core.units import Float64Array

_LENGTH = 4096


class PositionHistory:
    """The last polls of two positions, written by one thread and read by another."""

    def __init__(self) -> None:
        self._rows: deque[tuple[int, float, float, int, int]] = deque(maxlen=_LENGTH)

    def append(
        self, stamp_ns: int, first: float, second: float, error_ns: int = 0, answered_ns: int = 0
    ) -> None:
        """Add a poll, which may have been answered ``error_ns`` before or after its stamp.

        The second position is known to be from before ``answered_ns``; 0: it is as old as the first.
        """
        self._rows.append((stamp_ns, first, second, error_ns, answered_ns or stamp_ns + error_ns))

    @property
    def last(self) -> tuple[float, float]:
        """The latest positions."""
        _, first, second, *_ = self._rows[-1]
        return first, second

    def measured(self, span_s: float = 0.04) -> tuple[float, float, float, int, int]:
        """Return the latest positions, the larger speed, and between which times they were measured.

        The speed is over polls at least ``span_s`` apart. It is the least that the two prove: an answer that
        was long in coming makes nothing fast.
        """
        rows = list(self._rows)
        last = rows[-1]
        between = last[0] - last[3], last[4]
        first = next((row for row in reversed(rows) if last[0] - row[0] >= span_s * 1e9), None)
        if first is None:
            return last[1], last[2], 0.0, *between
        ways = (abs(last[1] - first[1]), abs(last[2] - first[2]))
        longest_ns = last[0] + last[3] - (first[0] - first[3])
        return last[1], last[2], max(ways) / (longest_ns * 1e-9), *between

    def at(self, times_ns: Int64Array, beyond_s: float, *, moving: bool) -> tuple[Float64Array, Float64Array]:
        """Return both positions at times: straight between polls, past the last by its speed if it moves."""
        rows = self._since(int(times_ns[0]) if len(times_ns) else 0)
        stamps = np.array([row[0] for row in rows], dtype=np.int64)
        late_ns = int(times_ns[-1] - stamps[-1]) if len(times_ns) else 0
        if late_ns > beyond_s * 1e9:
            raise DeviceTimeout(f"stage: the last position is {late_ns * 1e-6:.0f} ms old; see its health")
        since_s, after_s = (stamps - stamps[-1]) * 1e-9, (times_ns - stamps[-1]) * 1e-9
        result = []
        for column in (1, 2):
            values = np.array([row[column] for row in rows])
            speed = 0.0
            if moving and len(rows) > 1 and since_s[-2] < 0.0:
                speed = float((values[-1] - values[-2]) / -since_s[-2])
            between = np.interp(after_s, since_s, values)
            result.append(np.where(after_s > 0.0, values[-1] + speed * after_s, between))
        return result[0], result[1]

    def _since(self, begin_ns: int) -> list[tuple[int, float, float, int, int]]:
        """Return the polls from the last one before a time on, in order; at least two if there are."""
        found = []
        for row in reversed(list(self._rows)):
            found.append(row)
            if row[0] <= begin_ns and len(found) > 1:
                break
        return found[::-1]


def crossing_ns(times_ns: Int64Array, place_m: Float64Array, wanted_m: float) -> int:
    """Return when a place was passed, linear between two samples; the last time if it was passed often."""
    beyond = place_m > wanted_m
    passes = np.flatnonzero(beyond[1:] != beyond[:-1])
    if not len(passes):
        raise DeviceError(f"stage: it never passed {wanted_m * 1e3:g} mm; see its positions")
    k = int(passes[-1])
    share = (wanted_m - place_m[k]) / (place_m[k + 1] - place_m[k])
    return int(times_ns[k]) + round(float(share) * int(times_ns[k + 1] - times_ns[k]))
