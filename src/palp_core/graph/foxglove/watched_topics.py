"""Topics of a running graph as a screen wants them: no faster than it can show, always with the latest."""

import contextlib
from collections.abc import Iterable

from palp_core.errors import SchemaMismatch
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.graph_reader import KIND_OFFSET, GraphReader
from palp_core.graph.messages.frame import Frame, Kind, parse
from palp_core.graph.messages.topic import Topic


class _Thinned:
    """The messages of one topic that are shown; whatever is left out, the latest comes."""

    def __init__(self, fastest_hz: float) -> None:
        self._period_ns = round(1e9 / fastest_hz) if fastest_hz else 0
        self._due_ns = 0
        self._ready: list[bytes] = []
        self._held: bytes | None = None
        self._last = (-1, 0)

    def take(self, raw: bytes, now_ns: int) -> None:
        if raw[raw.find(0) + KIND_OFFSET] != Kind.DATA:
            return
        if now_ns < self._due_ns:
            self._held = raw
            return
        self._ready.append(raw)
        self._held, self._due_ns = None, now_ns + self._period_ns

    def due(self, now_ns: int) -> list[Frame]:
        """Return the messages that are due; of a publisher that moves none comes after its successor's."""
        if self._held is not None and now_ns >= self._due_ns:
            self.take(self._held, now_ns)
        ready, self._ready = self._ready, []
        found = []
        for raw in ready:
            with contextlib.suppress(SchemaMismatch):  # not ours; the readers count such frames
                frame = parse(raw)
                if (frame.epoch, frame.sequence) > self._last:
                    self._last = (frame.epoch, frame.sequence)
                    found.append(frame)
        return found


class WatchedTopics:
    """The topics that are looked at; of each, so many messages per second of the machine's clock, 0: all."""

    def __init__(self, reader: GraphReader, fastest_hz: float) -> None:
        self._reader, self._fastest_hz = reader, fastest_hz
        self._watched: dict[str, _Thinned] = {}

    def watch(self, topics: Iterable[Topic], *, every: bool = False) -> None:
        """Read more topics; of all their messages ``every`` one."""
        for topic in topics:
            if topic.name not in self._watched:
                thinned = self._watched[topic.name] = _Thinned(0.0 if every else self._fastest_hz)
                self._reader.follow([topic], thinned.take)

    def leave(self, names: Iterable[str]) -> None:
        self._reader.leave([name for name in names if self._watched.pop(name, None) is not None])

    def receive(self, wait_ms: int) -> list[Frame]:
        """Return the messages that have arrived and are due, after waiting for some so long."""
        self._reader.receive(wait_ms)
        now_ns = monotonic_ns()
        return [frame for thinned in self._watched.values() for frame in thinned.due(now_ns)]
