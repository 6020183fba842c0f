"""Messages of topics of a running graph in their order; what is missing is asked for, or counted."""

from collections import deque
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
HISTORY_TIMEOUT_S = 2.0


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
        self._in_order: deque[Frame] = deque()
        self._gaps: deque[tuple[str, int, int]] = deque()
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
                self._in_order.append,
                self._add_gap,
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
        self._reader.receive(TICK_MS, slice_ns)
        now_ns = monotonic_ns()
        for buffer in self._buffers.values():
            buffer.expire(now_ns)
        self._complete(now_ns)
        received, self._received = self._received, []
        for message in received:
            take(message)

    def _arrive(self, raw: bytes, arrived_ns: int) -> None:
        try:
            frame = parse(raw)
        except SchemaMismatch:
            return  # not ours; the readers count such frames
        if frame.kind != Kind.MOVED:
            self.last_sequence[frame.topic] = frame.sequence
            self._buffers[frame.topic].arrive(frame, arrived_ns)
        self._complete(arrived_ns)

    def _complete(self, arrived_ns: int) -> None:
        """Account for what is in order; ask the publishers for the gaps, and account for the answers."""
        while True:
            while self._in_order:
                self._account_for(self._in_order.popleft(), arrived_ns)
            if not self._gaps:
                return
            self._fill(*self._gaps.popleft())
            arrived_ns = monotonic_ns()

    def _account_for(self, frame: Frame, arrived_ns: int) -> None:
        account = self._accounts[frame.topic]
        lost_before = account.lost
        if frame.kind != Kind.DATA:
            account.heartbeat(frame.epoch, frame.sequence)
            if account.lost > lost_before:
                self._received.append(ReceivedFrame(frame, arrived_ns, account.lost - lost_before))
        elif account.accept(frame.epoch, frame.sequence):
            self._received.append(ReceivedFrame(frame, arrived_ns, account.lost - lost_before))

    def _add_gap(self, topic: str, first: int, last: int) -> None:
        self._gaps.append((topic, first, last))

    def _fill(self, topic: str, first: int, last: int) -> None:
        """Ask the publisher for messages; what it no longer has is a gap."""
        buffer = self._buffers[topic]
        try:
            frames = self._reader.graph.history(
                self._nodes[topic], topic, first=first, last=last, timeout_s=HISTORY_TIMEOUT_S
            )
        except GraphError:
            frames = []
        epoch = frames[0].epoch if frames else buffer.epoch
        buffer.fill(epoch, frames, monotonic_ns())
