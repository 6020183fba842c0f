"""Frames of a running graph, each for the observer of its topic; publishers are followed when they move."""

import contextlib
from collections.abc import Callable, Iterable
from typing import Self

from palp_core.errors import SchemaMismatch
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.frame import Kind, parse
from palp_core.graph.messages.topic import Topic
from palp_core.graph.transport.migration import Migration, Reorderer
from palp_core.graph.transport.requester_socket import RequesterSocket
from palp_core.graph.transport.subscriber_socket import RECEIVE_QUEUE, SubscriberSocket

SLICE_NS = 20_000_000
LOOK_NS = 100_000_000
KIND_OFFSET = 2  # from the NUL: version, kind

Observer = Callable[[bytes, int], object]
"""Takes a frame and when it arrived, on the machine's monotonic clock."""


class GraphReader:
    """The receiving end of a process that watches a graph."""

    def __init__(
        self,
        graph: RunningGraph,
        *,
        queue: int = RECEIVE_QUEUE,
        name: str = "",
        on_change: Callable[[], None] = lambda: None,
    ) -> None:
        self.graph = graph
        self.ended = False
        self._on_change = on_change
        self._subscriber = SubscriberSocket({}, queue=queue, name=name)
        self._orders: dict[str, Reorderer] = {}
        self._migration = Migration(self._subscriber, {}, self._orders)
        self._observers: dict[bytes, Observer] = {}
        self._publish: dict[str, str] = {}
        self._record = graph.record
        self._next_look_ns = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def follow(self, topics: Iterable[Topic], observe: Observer, order: Reorderer | None = None) -> None:
        """Hand frames of more topics to an observer; those that are followed already stay as they are.

        An ``order`` holds back what comes out of order while a publisher moves.
        """
        new = {topic.name: topic.publish for topic in topics if topic.name not in self._publish}
        for name, publish in new.items():
            self._publish[name], self._observers[name.encode()] = publish, observe
            if order is not None:
                self._orders[name] = order
            self._migration.add(name, publish, "")
        self._subscriber.subscribe(new)

    def follows(self, name: str) -> bool:
        return name in self._publish

    def leave(self, names: Iterable[str]) -> None:
        """Follow topics no longer; their publishers send them to this process no more."""
        known = [name for name in names if self._publish.pop(name, None) is not None]
        self._subscriber.unsubscribe(known)
        for name in known:
            del self._observers[name.encode()]
            self._orders.pop(name, None)
            self._migration.remove(name)

    def receive(self, wait_ms: int, slice_ns: int = SLICE_NS) -> bool:
        """Hand on what has arrived, after waiting for it; return whether there may be more."""
        more = self._subscriber.dispatch(self._arrive, slice_ns, wait_ms)
        now_ns = monotonic_ns()
        self._migration.tick(now_ns)
        if now_ns >= self._next_look_ns:
            self._next_look_ns = now_ns + LOOK_NS
            self.ended = not self.graph.alive
            if self.graph.refresh() is not self._record:
                self._record = self.graph.record
                self._relocate()
                self._on_change()
        return more

    @property
    def file_descriptors(self) -> tuple[int, ...]:
        """Become readable when :meth:`receive` has something to do; none where it may have already."""
        return () if self._subscriber.receive_pending else (self._subscriber.file_descriptor,)

    def server(self, name: str) -> str:
        """Return where a topic's publisher answers since it moved; "" if it has not."""
        return self._migration.servers[name]

    def requester(self) -> RequesterSocket:
        """Return a socket for requests whose answers are not waited for."""
        return RequesterSocket(self._subscriber.context)

    def close(self) -> None:
        self._subscriber.close()

    def _arrive(self, raw: bytes, now_ns: int) -> None:
        end = raw.find(0)
        observe = self._observers.get(raw[:end])
        if observe is None or len(raw) <= end + KIND_OFFSET:
            return
        if raw[end + KIND_OFFSET] == Kind.MOVED:
            with contextlib.suppress(SchemaMismatch):
                self._migration.follow(parse(raw), now_ns)
        observe(raw, now_ns)

    def _relocate(self) -> None:
        """Connect to where publishers are according to the record.

        After a swap the record's name of a publisher leads to its successor, which is followed already: only
        a name that changes is connected to.
        """
        for entry in self._record.topics:
            if entry.publish != self._publish.get(entry.name, entry.publish):
                self._publish[entry.name] = entry.publish
                self._migration.relocate(entry.name, entry.publish)
