"""Who is alive: nodes on the wall clock say twice a second that their loop turns."""

from collections.abc import Iterator
from typing import Generic, TypeVar

from palp_core.graph.messages.builtin import NodeHealth

HANG_NS = 3_000_000_000
"""Silence after which a node is called unresponsive (assumed): six pulses missed. A loaded host delays one or
two; a handler that takes this long has missed every deadline of a rig, and a person will want to know."""

GIVE_UP_NS = 10_000_000_000
"""Silence after which a node whose rule restarts it is restarted (assumed: no handler takes this long)."""

_BLIND_NS = 1_000_000_000


Key = TypeVar("Key", int, str)


class Liveness(Generic[Key]):
    """Each node's last heartbeat and health; only time in which the supervisor itself worked is silence."""

    def __init__(self) -> None:
        self.silent: set[Key] = set()
        self._last_ns: dict[Key, int] = {}
        self._health: dict[Key, NodeHealth] = {}
        self._checked_ns = 0

    def expect(self, index: Key, now_ns: int) -> None:
        """Expect heartbeats from now on; its loop has turned before it is active."""
        self._last_ns[index] = now_ns

    def forget(self, index: Key) -> None:
        """Expect nothing more: the process is gone, or about to go."""
        self._last_ns.pop(index, None)
        self._health.pop(index, None)
        self.silent.discard(index)

    def record(self, index: Key, health: NodeHealth, now_ns: int) -> bool:
        """Take a pulse; return True if the node was unresponsive until now."""
        self._health[index] = health
        if index in self._last_ns:
            self._last_ns[index] = now_ns
        was_silent = index in self.silent
        self.silent.discard(index)
        return was_silent

    def unresponsive(self, now_ns: int) -> Iterator[tuple[Key, int]]:
        """Yield each node that is unresponsive, and its silence in ns."""
        if now_ns - self._checked_ns > _BLIND_NS:
            blind_ns = now_ns - self._checked_ns
            self._last_ns = {i: min(last_ns + blind_ns, now_ns) for i, last_ns in self._last_ns.items()}
        self._checked_ns = now_ns
        for index, last_ns in list(self._last_ns.items()):
            if now_ns - last_ns >= HANG_NS and index in self._health:
                yield index, now_ns - last_ns

    def newly_silent(self, index: Key, silent_ns: int) -> str:
        """Return that a node is unresponsive, once until its next heartbeat; else ""."""
        if index in self.silent:
            return ""
        self.silent.add(index)
        return f"has sent no heartbeat for {silent_ns / 1e9:.0f} s: stopped, or blocked in a handler"

    @property
    def health(self) -> list[NodeHealth]:
        """The last health of each node, in graph order."""
        return [self._health[index] for index in sorted(self._health)]
