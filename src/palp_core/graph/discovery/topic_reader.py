"""Messages of topics of a running graph in their order; what is missing is asked for, or counted."""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple, Self

from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.graph_reader import GraphReader
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.frame import HEADER_BYTES, Frame, Kind, parse
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.topic import Topic
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.transport.migration import PATIENCE_NS
from palp_core.graph.transport.reorder_buffer import ReorderBuffer

TICK_MS = 100
SLICE_NS = 500_000
ANSWER_MS = 5
"""How long frames are waited for while a publisher is asked for what is missing."""


class ReceivedFrame(NamedTuple):
    """A message, when it arrived on the machine's clock, and how many before it were missed for good.

    Or a heartbeat, if that revealed that something was missed.
    """

    frame: Frame
    arrived_ns: int
    lost: int

    @property
    def is_message(self) -> bool:
        return self.frame.kind == Kind.DATA

    @property
    def size_bytes(self) -> int:
        return len(self.frame.topic.encode()) + 1 + HEADER_BYTES + len(self.frame.payload)


class TopicReader:
    """Follows topics of a running graph.

    Attributes:
        last_sequence: Per topic the last sequence that its publisher stated, of messages or heartbeats.
    """

    def __init__(
        self,
        graph: RunningGraph,
        topics: Sequence[Topic],
        *,
        history_depth: int = 0,
        reliable: bool = False,
    ) -> None:
        self._reader = GraphReader(graph)
        self._nodes: dict[str, str] = {}
        self._accounts: dict[str, SequenceAccount] = {}
        self._buffers: dict[str, ReorderBuffer] = {}
        self._requester = self._reader.requester()
        self._now_ns = 0
        self._received: list[ReceivedFrame] = []
        self.last_sequence: dict[str, int] = {}
        self._qos = Qos(
            reliability="reliable" if reliable or history_depth else "best_effort",
            durability="transient_local" if history_depth else "volatile",
            depth=max(1, history_depth),
        )
        self.follow(topics)

    @property
    def ended(self) -> bool:
        return self._reader.ended

    def follow(self, topics: Sequence[Topic]) -> None:
        """Follow more topics; those that are followed already stay as they are."""
        for topic in topics:
            if topic.name in self._nodes:
                continue
            account = self._accounts[topic.name] = SequenceAccount()
            self._nodes[topic.name] = topic.node
            buffer = self._buffers[topic.name] = ReorderBuffer(
                topic.name,
                self._qos,
                account,
                self._account_for,
                self._ask,
                patience_ns=PATIENCE_NS,
            )
            self._reader.follow([topic], self._arrive, buffer)

    def leave(self, names: Iterable[str]) -> None:
        known = [name for name in names if self._nodes.pop(name, None) is not None]
        self._reader.leave(known)
        for name in known:
            del self._accounts[name], self._buffers[name]
            self.last_sequence.pop(name, None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._requester.close()
        self._reader.close()

    def messages(self) -> Iterator[ReceivedFrame | None]:
        """Yield messages as they come, and None every tenth of a second; end when the graph has."""
        received: list[ReceivedFrame] = []
        while not self.ended:
            self.turn(received.append)
            yield from received
            received.clear()
            yield None

    def turn(self, take: Callable[[ReceivedFrame], object], slice_ns: int = SLICE_NS) -> None:
        """Hand over what comes: wait for it a tenth of a second at most, and take it for a slice of time."""
        is_asking = any(buffer.give_up_ns is not None for buffer in self._buffers.values())
        self._reader.receive(ANSWER_MS if is_asking else TICK_MS, slice_ns)
        self._now_ns = monotonic_ns()
        self._take_answers()
        for buffer in self._buffers.values():
            buffer.expire(self._now_ns)
            while self.ended and buffer.give_up_ns is not None:  # no publisher answers any more
                buffer.expire(buffer.give_up_ns)
        received, self._received = self._received, []
        for message in received:
            take(message)

    def _arrive(self, raw: bytes, arrived_ns: int) -> None:
        self._now_ns = arrived_ns
        try:
            frame = parse(raw)
        except SchemaMismatch:
            return  # not ours; the readers count such frames
        if frame.kind != Kind.MOVED:
            self.last_sequence[frame.topic] = frame.sequence
            self._buffers[frame.topic].arrive(frame, arrived_ns)

    def _account_for(self, frame: Frame) -> None:
        account = self._accounts[frame.topic]
        lost_before = account.lost
        is_new = frame.kind == Kind.DATA and account.accept(frame.epoch, frame.sequence)
        if frame.kind != Kind.DATA:
            account.heartbeat(frame.epoch, frame.sequence)
        lost = account.lost - lost_before
        if is_new or lost:
            self._received.append(ReceivedFrame(frame, self._now_ns, lost))

    def _ask(self, topic: str, first: int, last: int) -> None:
        """Ask the publisher for messages; what it no longer has is a gap."""
        with contextlib.suppress(GraphError):  # it has left
            serve = self._reader.server(topic) or self._reader.graph.node(self._nodes[topic]).serve
            self._requester.ask_history(serve, topic, first, last)

    def _take_answers(self) -> None:
        for reply in self._requester.replies():
            buffer = self._buffers.get(reply.get("topic", ""))
            if buffer is not None:
                with contextlib.suppress(SchemaMismatch):  # of another version: given up in time
                    buffer.fill(reply["epoch"], [parse(raw) for raw in reply["frames"]], self._now_ns)
