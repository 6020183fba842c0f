"""Messages of a running graph as they are published; what is missing is asked for, or counted and said."""

import contextlib
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, Self

from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.frame import HEADER_BYTES, PLAIN_DATA, Frame, Kind, parse, quick_header
from palp_core.graph.messages.qos import Qos
from palp_core.graph.messages.topic import Topic
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.transport.migration import PATIENCE_NS, Migration
from palp_core.graph.transport.reorder_buffer import ReorderBuffer
from palp_core.graph.transport.subscriber_socket import SubscriberSocket

TICK_MS = 100
SLICE_NS = 500_000
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
        topics: Sequence[Topic],
        *,
        history_depth: int = 0,
        reliable: bool = False,
    ) -> None:
        self._graph = graph
        self._nodes: dict[str, str] = {}
        self._accounts: dict[str, SequenceAccount] = {}
        self._next_look_ns = 0
        self.last_sequence: dict[str, int] = {}
        self.ended = False
        self._subscriber = SubscriberSocket({})
        self._in_order: deque[Frame] = deque()
        self._gaps: deque[tuple[str, int, int]] = deque()
        self._qos = Qos(
            reliability="reliable" if reliable or history_depth else "best_effort",
            durability="transient_local" if history_depth else "volatile",
            depth=max(1, history_depth),
        )
        self._buffers: dict[str, ReorderBuffer] = {}
        self._quick: dict[bytes, ReorderBuffer] = {}
        self._migration = Migration(self._subscriber, {}, self._buffers)
        self.follow(topics)

    def follow(self, topics: Sequence[Topic]) -> None:
        """Follow more topics; those that are followed already stay as they are."""
        new = {topic.name: topic for topic in topics if topic.name not in self._nodes}
        for name, topic in new.items():
            self._nodes[name], self._accounts[name] = topic.node, SequenceAccount()
            self._buffers[name] = ReorderBuffer(
                name,
                self._qos,
                self._accounts[name],
                self._in_order.append,
                self._note_gap,
                patience_ns=PATIENCE_NS,
            )
            self._quick[name.encode()] = self._buffers[name]
            self._migration.add(name, topic.publish, "")
        self._subscriber.subscribe({name: topic.publish for name, topic in new.items()})

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._subscriber.close()

    def messages(self) -> Iterator[ReceivedFrame | None]:
        """Yield messages as they come, and None every tenth of a second; end when the graph has."""
        heard: list[ReceivedFrame] = []
        while not self.ended:
            self.turn(heard.append)
            yield from heard
            heard.clear()
            yield None

    def turn(self, take: Callable[[ReceivedFrame], object]) -> None:
        """Hand over what comes, as it comes, for a tenth of a second at most."""

        def arrive(raw: bytes, arrived_ns: int) -> None:
            for received in self._hear(raw, arrived_ns):
                take(received)

        self._subscriber.dispatch(arrive, SLICE_NS, TICK_MS)
        now_ns = monotonic_ns()
        self._migration.tick(now_ns)
        for buffer in self._buffers.values():
            buffer.expire(now_ns)
        for received in self._complete(now_ns):
            take(received)
        if now_ns >= self._next_look_ns:
            self._next_look_ns = now_ns + LOOK_AT_LAUNCHER_NS
            self.ended = not self._graph.alive

    def _hear(self, raw: bytes, arrived_ns: int) -> Iterator[ReceivedFrame]:
        """Take a frame, and yield what comes of it."""
        if (received := self._next(raw, arrived_ns)) is not None:
            yield received
            return
        try:
            frame = parse(raw)
        except SchemaMismatch:
            return  # not ours; the readers count such frames
        yield from self._take(frame, arrived_ns)

    def _next(self, raw: bytes, arrived_ns: int) -> ReceivedFrame | None:
        """Take a message that is next in its order, as nearly every one is, the short way; or return None."""
        end = raw.find(0)
        buffer = self._quick.get(raw[:end])
        if buffer is None or len(raw) < end + 1 + HEADER_BYTES or buffer.give_up_ns is not None:
            return None
        head, epoch, sequence, stamp_ns, type_hash = quick_header(raw, end + 1)
        account = self._accounts[buffer.topic]
        if head != PLAIN_DATA or sequence != buffer.next or epoch != buffer.epoch:
            return None
        lost_before = account.lost
        if sequence <= account.sequence or not account.accept(epoch, sequence):
            return None
        buffer.next, buffer.heard_ns, buffer.data_ns = sequence + 1, arrived_ns, arrived_ns
        self.last_sequence[buffer.topic] = sequence
        payload = memoryview(raw)[end + 1 + HEADER_BYTES :]
        frame = Frame(buffer.topic, Kind.DATA, epoch, sequence, stamp_ns, type_hash, payload)
        return ReceivedFrame(frame, arrived_ns, account.lost - lost_before)

    def _take(self, frame: Frame, arrived_ns: int) -> Iterator[ReceivedFrame]:
        buffer = self._buffers.get(frame.topic)
        if buffer is None:
            return
        if frame.kind == Kind.MOVED:
            with contextlib.suppress(SchemaMismatch):
                self._migration.follow(frame, arrived_ns)
        else:
            self.last_sequence[frame.topic] = frame.sequence
            buffer.arrive(frame, arrived_ns)
        yield from self._complete(arrived_ns)

    def _complete(self, arrived_ns: int) -> Iterator[ReceivedFrame]:
        """Yield what is in order, and then what comes of it that the publishers are asked for the gaps."""
        while True:
            while self._in_order:
                yield from self._account_for(self._in_order.popleft(), arrived_ns)
            if not self._gaps:
                return
            self._fill(*self._gaps.popleft())
            arrived_ns = monotonic_ns()

    def _account_for(self, frame: Frame, arrived_ns: int) -> Iterator[ReceivedFrame]:
        account = self._accounts[frame.topic]
        lost_before = account.lost
        if frame.kind != Kind.DATA:
            account.heartbeat(frame.epoch, frame.sequence)
            if account.lost > lost_before:
                yield ReceivedFrame(frame, arrived_ns, account.lost - lost_before)
        elif account.accept(frame.epoch, frame.sequence):
            yield ReceivedFrame(frame, arrived_ns, account.lost - lost_before)

    def _note_gap(self, topic: str, first: int, last: int) -> None:
        self._gaps.append((topic, first, last))

    def _fill(self, topic: str, first: int, last: int) -> None:
        """Ask the publisher for messages; what it no longer has is a gap."""
        buffer = self._buffers[topic]
        asked: dict[str, Any] = {"topic": topic, "first": first, "last": last}
        try:
            reply = self._graph.ask(self._nodes[topic], "history", timeout_s=HISTORY_TIMEOUT_S, **asked)
        except GraphError:
            reply = {"epoch": buffer.epoch, "frames": []}
        buffer.fill(reply["epoch"], [parse(raw) for raw in reply["frames"]], monotonic_ns())
