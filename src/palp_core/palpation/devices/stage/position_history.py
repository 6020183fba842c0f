"""Where the axes were at the polls, and from that where they were in between and when they passed a place."""

from collections import deque
from typing import NamedTuple

import numpy as np

from palp_core.errors import DeviceError, DeviceTimeout
from palp_core.palpation.devices.protocols import Int64Array
from palp_core.units import Float64Array

_LENGTH = 4096


class _Poll(NamedTuple):
    stamp_ns: int
    places: tuple[float, ...]
    error_ns: int
    answered_ns: int


class PositionHistory:
    """The last polls of some positions, written by one thread and read by another."""

    def __init__(self) -> None:
        self._rows: deque[_Poll] = deque(maxlen=_LENGTH)

    def append(self, stamp_ns: int, places: tuple[float, ...], error_ns: int, answered_ns: int) -> None:
        """Add a poll, whose first position may have been answered ``error_ns`` before or after its stamp.

        The others are known to be from before ``answered_ns``.
        """
        self._rows.append(_Poll(stamp_ns, places, error_ns, answered_ns))

    @property
    def last(self) -> tuple[float, ...]:
        """The latest positions."""
        return self._rows[-1].places

    def measured(self, span_s: float = 0.04) -> tuple[tuple[float, ...], float, int, int]:
        """Return the latest positions, the largest speed, and between which times they were measured.

        The speed is over polls at least ``span_s`` apart. It is the least that the two prove: an answer that
        was long in coming makes nothing fast.
        """
        rows = list(self._rows)
        last = rows[-1]
        between = last.stamp_ns - last.error_ns, last.answered_ns
        first = next((row for row in reversed(rows) if last.stamp_ns - row.stamp_ns >= span_s * 1e9), None)
        if first is None:
            return last.places, 0.0, *between
        ways = (abs(after - before) for after, before in zip(last.places, first.places, strict=True))
        longest_ns = last.stamp_ns + last.error_ns - (first.stamp_ns - first.error_ns)
        return last.places, max(ways) / (longest_ns * 1e-9), *between

    def at(self, times_ns: Int64Array, beyond_s: float, *, moving: bool) -> list[Float64Array]:
        """Return all positions at times: straight between polls, past the last by its speed if it moves."""
        rows = self._since(int(times_ns[0]) if len(times_ns) else 0)
        stamps = np.array([row.stamp_ns for row in rows], dtype=np.int64)
        late_ns = int(times_ns[-1] - stamps[-1]) if len(times_ns) else 0
        if late_ns > beyond_s * 1e9:
            raise DeviceTimeout(f"stage: the last position is {late_ns * 1e-6:.0f} ms old; see its health")
        since_s, after_s = (stamps - stamps[-1]) * 1e-9, (times_ns - stamps[-1]) * 1e-9
        result = []
        for values in np.array([row.places for row in rows]).T:
            speed = 0.0
            if moving and len(rows) > 1 and since_s[-2] < 0.0:
                speed = float((values[-1] - values[-2]) / -since_s[-2])
            between = np.interp(after_s, since_s, values)
            result.append(np.where(after_s > 0.0, values[-1] + speed * after_s, between))
        return result

    def _since(self, begin_ns: int) -> list[_Poll]:
        """Return the polls from the last one before a time on, in order; at least two if there are."""
        found = []
        for row in reversed(list(self._rows)):
            found.append(row)
            if row.stamp_ns <= begin_ns and len(found) > 1:
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
