"""How far another host's clock is ahead: exchanges of times, as NTP does it.

A round trip that begins at t0 and ends at t3 on this clock and passes t1 on the other (RFC 5905, section 8,
with t1 = t2) gives the offset t1 - (t0 + t3) / 2, wrong by at most half its length whatever each way took.
"""

from collections import deque
from typing import NamedTuple


class Offset(NamedTuple):
    """The other clock minus this one, and the most that can be wrong about it, both in ns."""

    offset_ns: int
    uncertainty_ns: int


class OffsetEstimate:
    """The best of the latest exchanges: the shortest round trip.

    Args:
        window: Exchanges that count; the clocks' rates differ, so that old ones mislead.
    """

    def __init__(self, window: int = 32) -> None:
        self._latest: deque[Offset] = deque(maxlen=window)

    def __len__(self) -> int:
        return len(self._latest)

    def add(self, sent_ns: int, there_ns: int, received_ns: int) -> None:
        """Take an exchange into account."""
        if received_ns >= sent_ns:
            middle_ns = (sent_ns + received_ns) // 2
            self._latest.append(Offset(there_ns - middle_ns, (received_ns - sent_ns + 1) // 2))

    def best(self) -> Offset:
        """Return the estimate of the shortest round trip; there must have been one."""
        return min(self._latest, key=lambda offset: offset.uncertainty_ns)
