"""What holds a moving device: the permission of the safety process, which must be renewed all the time."""

from palp_core.palpation.devices.limits import check_range


class MotionPermit:
    """Permission to move, which ends by itself.

    A beat counts from when it was sent, so that one that waited in a queue while its reader was stopped
    renews nothing, nor does one that is older than the last or says to be sent later than it is now.
    """

    def __init__(self, longest_s: float = 0.050) -> None:
        check_range("motion permit", "longest_s", longest_s, 1e-3, 10.0)
        self._longest_ns = round(longest_s * 1e9)
        self._sent_ns: int | None = None
        self._permits = False

    def renew(self, sent_ns: int, *, permits: bool) -> None:
        """Take note of a beat and what it says; a permission that is older than the last word is none."""
        if permits and self._sent_ns is not None and sent_ns < self._sent_ns:
            return
        self._sent_ns, self._permits = sent_ns, permits

    @property
    def lost_text(self) -> str:
        """What to say when it is not alive: the node's parameter ``beat_ms`` sets the limit."""
        return f"no heartbeat of the safety node, the limit is {self._longest_ns / 1e6:g} ms (beat_ms)"

    def alive(self, now_ns: int) -> bool:
        """Return whether the last beat is fresh, whatever it says."""
        return self._sent_ns is not None and abs(now_ns - self._sent_ns) <= self._longest_ns

    def permits(self, now_ns: int) -> bool:
        """Return whether anything may move now."""
        return self._permits and self.alive(now_ns)
