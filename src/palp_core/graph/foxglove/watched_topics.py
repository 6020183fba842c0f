"""Topics of a running graph as a screen wants them: while somebody looks, and no faster than it can show.

Nothing is asked for again and nobody waits for this reader: what it cannot take is dropped.
"""

import contextlib
from collections.abc import Iterable, Mapping

from palp_core.errors import SchemaMismatch
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.frame import Frame, Kind, parse
from palp_core.graph.messages.topic import Topic
from palp_core.graph.transport.migration import Migration
from palp_core.graph.transport.subscriber_socket import SubscriberSocket

SLICE_NS = 20_000_000
_KIND_OFFSET = 2  # from the NUL: version, kind


class _Watched:
    """A topic that is looked at; ``held`` is the latest message that came before the next was due."""

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.due_ns = 0
        self.held: bytes | None = None
        self.last = (-1, 0)


class WatchedTopics:
    """The receiving end.

    Args:
        fastest_hz: Most messages of a topic per second of the machine's clock; 0: all. Whatever is left out,
            the latest of a topic comes.
    """

    def __init__(self, fastest_hz: float) -> None:
        self._period_ns = round(1e9 / fastest_hz) if fastest_hz else 0
        self._watched: dict[bytes, _Watched] = {}
        self._ready: list[bytes] = []
        self._subscriber = SubscriberSocket({})
        self._migration = Migration(self._subscriber, {})

    def watch(self, topics: Mapping[str, Topic], *, every: bool = False) -> None:
        """Listen to more topics, by name; of all their messages to ``every`` one."""
        new = {name: topic for name, topic in topics.items() if name.encode() not in self._watched}
        for name, topic in new.items():
            self._watched[name.encode()] = _Watched(0 if every else self._period_ns)
            self._migration.add(name, topic.publish, "")
        self._subscriber.subscribe({name: topic.publish for name, topic in new.items()})

    def watches(self, name: str) -> bool:
        """Tell whether a topic is listened to."""
        return name.encode() in self._watched

    def leave(self, names: Iterable[str]) -> None:
        """Listen to topics no longer: nobody looks at them."""
        known = [name for name in names if self._watched.pop(name.encode(), None) is not None]
        self._subscriber.unsubscribe(known)
        for name in known:
            self._migration.remove(name)

    def relocate(self, topics: Iterable[Topic]) -> None:
        """Take the run directory's word for where topics are published now."""
        for topic in topics:
            if topic.name.encode() in self._watched:
                self._migration.relocate(topic.name, topic.publish)

    def receive(self, wait_ms: int) -> list[Frame]:
        """Return the messages that have arrived and are due, after waiting for some so long."""
        self._subscriber.dispatch(self._arrive, SLICE_NS, wait_ms)
        now_ns = monotonic_ns()
        self._migration.tick(now_ns)
        for watched in self._watched.values():
            if watched.held is not None and now_ns >= watched.due_ns:
                self._ready.append(watched.held)
                watched.held, watched.due_ns = None, now_ns + watched.period_ns
        ready, self._ready = self._ready, []
        return [frame for raw in ready if (frame := self._newer(raw)) is not None]

    def close(self) -> None:
        """Let go."""
        self._subscriber.close()

    def _arrive(self, raw: bytes, now_ns: int) -> None:
        end = raw.find(0)
        if len(raw) <= end + _KIND_OFFSET:
            return
        watched = self._watched.get(raw[:end])
        if watched is None:
            return
        kind = raw[end + _KIND_OFFSET]
        if kind == Kind.MOVED:
            with contextlib.suppress(SchemaMismatch):
                self._migration.follow(parse(raw), now_ns)
        elif kind == Kind.DATA and now_ns >= watched.due_ns:
            watched.held, watched.due_ns = None, now_ns + watched.period_ns
            self._ready.append(raw)
        elif kind == Kind.DATA:
            watched.held = raw

    def _newer(self, raw: bytes) -> Frame | None:
        """Parse a message; of a publisher on the move one may come after its successor, and is left out."""
        try:
            frame = parse(raw)
        except SchemaMismatch:
            return None  # not ours; the readers count such frames
        watched = self._watched.get(frame.topic.encode())
        if watched is None or (frame.epoch, frame.sequence) <= watched.last:
            return None
        watched.last = (frame.epoch, frame.sequence)
        return frame
