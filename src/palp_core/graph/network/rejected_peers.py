"""Who was turned away, why and how often; logged at a bounded rate, remembered in bounded memory."""

from collections import OrderedDict

import msgspec

MOST_ENTRIES = 256
BURST = 10
PERIOD_NS = 1_000_000_000


class RejectedPeer(msgspec.Struct, kw_only=True):
    """One kind of stranger.

    Attributes:
        address: Where it came from; "" where it had hung up before it could be asked.
        key: Its public key; "" if it showed none.
        reason: Why it was turned away, and what to do.
        count: How often.
    """

    address: str
    key: str
    reason: str
    count: int = 0
    first_unix_ns: int = 0
    last_unix_ns: int = 0

    def __str__(self) -> str:
        who = f"a stranger from {self.address or 'an unknown address'}"
        key = f" with the public key {self.key}" if self.key else ""
        often = f" ({self.count} times)" if self.count > 1 else ""
        return f"refused {who}{key}: {self.reason}{often}"


class RejectedPeers:
    """Counts strangers."""

    def __init__(self) -> None:
        self.total_count = 0
        self._entries: OrderedDict[tuple[str, str, str], RejectedPeer] = OrderedDict()
        self._lines_left = BURST
        self._refilled_ns = 0

    def note(self, address: str, key: str, reason: str, now_unix_ns: int) -> RejectedPeer | None:
        """Count a refusal; return it if it is worth a line in the log.

        That is the 1st, 2nd, 4th, 8th ... of a kind, no more than ten at once and one a second on average.
        """
        self.total_count += 1
        kind = (address, key, reason)
        entry = self._entries.pop(kind, None)
        if entry is None:
            entry = RejectedPeer(address=address, key=key, reason=reason, first_unix_ns=now_unix_ns)
            if len(self._entries) >= MOST_ENTRIES:
                self._entries.popitem(last=False)
        self._entries[kind] = entry
        entry.count += 1
        entry.last_unix_ns = now_unix_ns
        if entry.count & (entry.count - 1) or not self._may_log(now_unix_ns):
            return None
        return entry

    def _may_log(self, now_ns: int) -> bool:
        periods = max(now_ns - self._refilled_ns, 0) // PERIOD_NS
        if periods:
            self._lines_left = min(self._lines_left + periods, BURST)
            self._refilled_ns = now_ns
        if not self._lines_left:
            return False
        self._lines_left -= 1
        return True

    def latest(self) -> list[RejectedPeer]:
        """Return the kinds of strangers, the latest first."""
        return list(reversed(self._entries.values()))
