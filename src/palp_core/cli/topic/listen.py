"""Messages of a running graph as they are published; what is missing is asked for, or counted and said."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Self

from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.run_directory import TopicEntry
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.frame import HEADER_BYTES, Frame, Kind, parse
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.transport.migration import Migration, Turns
from palp_core.graph.transport.subscriber_socket import SubscriberSocket

TICK_S = 0.1
HISTORY_TIMEOUT_S = 2.0
LOOK_AT_LAUNCHER_NS = 500_000_000


class ReceivedFrame(NamedTuple):
    """A message, when it arrived on the machine's clock, and how many before it were missed for good.

    Or a heartbeat, if that revealed that something was missed.
    """

    frame: Frame
    arrived_ns: int
    lost: int

    @property
    def is_message(self) -> bool:
        """Whether it is one."""
        return self.frame.kind == Kind.DATA

    @property
    def size_bytes(self) -> int:
        """Size on the wire."""
        return len(self.frame.topic.encode()) + 1 + HEADER_BYTES + len(self.frame.payload)


class TopicReader:
    """Follows topics of a running graph.

    Args:
        graph: The graph.
        topics: What to follow.
        history_depth: So many messages from before are asked of the publishers' histories and come first.
        reliable: Ask the publisher for what is missing.

    Attributes:
        last_sequence: Per topic the last sequence that its publisher stated, of messages or heartbeats.
        ended: The graph has ended.
    """

    def __init__(
        self,
        graph: RunningGraph,
        topics: Sequence[TopicEntry],
        *,
        history_depth: int = 0,
        reliable: bool = False,
    ) -> None:
        self._graph = graph
        self._nodes = {topic.name: topic.node for topic in topics}
        self._counters = {topic.name: SequenceAccount() for topic in topics}
        self._history_depth = history_depth
        self._reliable = reliable or history_depth > 0
        self._next_look_ns = 0
        self.last_sequence: dict[str, int] = {}
        self.ended = False
        self._subscriber = SubscriberSocket({topic.name: topic.publish for topic in topics})
        self._ready: list[Frame] = []
        self._turns = {topic.name: Turns(self._ready.append) for topic in topics}
        places = {topic.name: (topic.publish, "") for topic in topics}
        self._following = Migration(self._subscriber, places, self._turns)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._subscriber.close()

    def messages(self) -> Iterator[ReceivedFrame | None]:
        """Yield messages as they come, and None every tenth of a second; end when the graph has."""
        while not self.ended:
            self._subscriber.wait(TICK_S)
            arrived_ns = monotonic_ns()
            for raw in self._subscriber.receive():
                with contextlib.suppress(SchemaMismatch):  # not ours; the readers count such frames
                    self._arrive(parse(raw), arrived_ns)
                while self._ready:
                    yield from self._take(self._ready.pop(0), arrived_ns)
            yield None
            if arrived_ns >= self._next_look_ns:
                self._next_look_ns = arrived_ns + LOOK_AT_LAUNCHER_NS
                self.ended = not self._graph.alive

    def _arrive(self, frame: Frame, arrived_ns: int) -> None:
        if frame.topic not in self._counters:
            return
        if frame.kind == Kind.MOVED:
            self._following.take(frame, arrived_ns)
        else:
            self._turns[frame.topic].arrive(frame, frame, arrived_ns)

    def _take(self, frame: Frame, arrived_ns: int) -> Iterator[ReceivedFrame]:
        counter = self._counters[frame.topic]
        self.last_sequence[frame.topic] = frame.sequence
        last_before = frame.sequence - (frame.kind == Kind.DATA)
        first_wanted = self._first_wanted(counter, frame.epoch, last_before)
        if first_wanted <= last_before:
            yield from self._fill(frame.topic, first_wanted, last_before)
        lost_before = counter.lost
        if frame.kind != Kind.DATA:
            counter.heartbeat(frame.epoch, frame.sequence)
            if counter.lost > lost_before:
                yield ReceivedFrame(frame, arrived_ns, counter.lost - lost_before)
        elif counter.accept(frame.epoch, frame.sequence):
            yield ReceivedFrame(frame, arrived_ns, counter.lost - lost_before)

    def _first_wanted(self, counter: SequenceAccount, epoch: int, last: int) -> int:
        """Return the first message to ask the history for, up to ``last``."""
        if counter.epoch < 0:
            return max(last - self._history_depth, 0) + 1
        if not self._reliable or epoch < counter.epoch:
            return last + 1
        return counter.sequence + 1 if epoch == counter.epoch else 1

    def _fill(self, topic: str, first: int, last: int) -> Iterator[ReceivedFrame]:
        """Ask the publisher for messages; what it no longer has shows as lost with the next that comes."""
        counter = self._counters[topic]
        while first <= last:
            try:
                reply = self._graph.ask(
                    self._nodes[topic],
                    "history",
                    timeout_s=HISTORY_TIMEOUT_S,
                    topic=topic,
                    first=first,
                    last=last,
                )
            except GraphError:
                return
            frames = [parse(raw) for raw in reply["frames"]]
            for frame in frames:
                before = counter.lost
                if counter.accept(frame.epoch, frame.sequence):
                    yield ReceivedFrame(frame, monotonic_ns(), counter.lost - before)
            if not frames or frames[-1].sequence < first:
                return
            first = frames[-1].sequence + 1  # a reply holds only so many bytes
