"""Everything that chosen topics of a running graph carry, from now on; what is missing is asked for.

A frame goes to the recorder as it arrives, so that a crash costs no more than an open chunk. What had to be
asked for comes after what was published later; the sequences have the order.
"""

import os
from collections import deque
from collections.abc import Callable, Mapping
from typing import NamedTuple

from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.bag.recorder import BagRecorder
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.graph_reader import GraphReader
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.builtin import Order
from palp_core.graph.messages.frame import Kind, parse, raw_of
from palp_core.graph.messages.message import decode, decode_any
from palp_core.graph.messages.topic import Topic
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.journal import ORDER_PORT
from palp_core.graph.node.spec import RECORDER

QUEUE = 100_000
ASK_S = 3.0
ANSWER_NS = 4_000_000_000
"""How long an answer is waited for; a publisher that is gone gives none, one on a busy host takes its time.

Nothing waits for it here as in a reader; it is less than what a replay allows a message to come late.
"""


class _Question(NamedTuple):
    epoch: int
    first: int
    last: int
    asked_ns: int


class LiveFeed:
    """The receiving end; ``sink`` takes every frame.

    ``from_start``: everything is expected from sequence 1 on; otherwise latched values come first, and the
    rest from where it is.
    """

    def __init__(
        self,
        graph: RunningGraph,
        sink: BagRecorder,
        *,
        from_start: bool,
        on_change: Callable[[], None] = lambda: None,
    ) -> None:
        self._reader = GraphReader(graph, queue=QUEUE, name=f"recorder {os.getpid()}", on_change=on_change)
        self.start_ns: int | None = None  # of the graph, on the machine's monotonic clock
        self.unmatched: dict[bytes, Topic] = {}  # of which no frame has come yet
        self._sink = sink
        self._from_start = from_start
        self._topics: dict[str, Topic] = {}
        self._new: set[str] = set()
        self._orders_to_begin: set[bytes] = set()
        self._requester = self._reader.requester()
        self._questions: dict[str, _Question] = {}
        self._waiting: dict[str, deque[_Question]] = {}
        self._latest_ns = 0
        self._answered_ns = 0

    def follow(self, topics: Mapping[str, Topic], *, new: bool = False) -> None:
        """Listen to more topics; of new ones the first messages are wanted."""
        self._new |= topics.keys() if new else set()
        self._topics.update(topics)
        self.unmatched |= {name.encode(): live for name, live in topics.items()}
        if not self._from_start:
            self._orders_to_begin |= {name.encode() for name in topics if is_order(name)}
        self._reader.follow(topics.values(), self._arrive)

    @property
    def ended(self) -> bool:
        return self._reader.ended

    def ask(self, topic: str, epoch: int, first: int, last: int) -> None:
        question = _Question(epoch, first, last, monotonic_ns())
        if not self._questions:
            self._answered_ns = question.asked_ns
        if topic in self._questions:
            self._waiting.setdefault(topic, deque()).append(question)
        else:
            self._send_question(topic, question)

    @property
    def asking(self) -> bool:
        return bool(self._questions)

    @property
    def file_descriptors(self) -> tuple[int, ...]:
        """Become readable when :meth:`receive` has something to do; none where it may have already."""
        return () if self.asking else self._reader.file_descriptors

    def answered_since(self, since_ns: int) -> bool:
        """Whether answers are to come, and one came, or the first question was put, since then.

        Of publishers that are gone none comes, however many questions there are.
        """
        return self.asking and self._answered_ns > since_ns

    def receive(self, wait_ms: int) -> bool:
        """Take what arrives, for a slice of time, after waiting for it; return whether there may be more."""
        more = self._reader.receive(wait_ms)
        if self._questions:
            self._take_answers()
        return more

    def now_ns(self, monotonic: int) -> int:
        """Return a time of the machine's monotonic clock on the graph's, as far as that is known."""
        if self.start_ns is None:
            return self._latest_ns
        return max(monotonic - self.start_ns, 0)

    def find_start(self) -> None:
        try:
            clock = self._reader.graph.ask("graph", "clock", timeout_s=0.5)
        except GraphError:
            return
        if clock["now_ns"]:
            self.start_ns = clock["monotonic_ns"] - clock["now_ns"]

    def close(self) -> None:
        self._requester.close()
        self._reader.close()

    def _arrive(self, raw: bytes, monotonic: int) -> None:
        end = raw.find(0)
        if self.unmatched and raw[:end] in self.unmatched:
            self._on_first_frame(raw, raw[:end])
        if self.start_ns is None:
            self._guess(raw)
        self._sink(self.now_ns(monotonic), raw)
        if self._orders_to_begin and raw[:end] in self._orders_to_begin:
            self._on_order(raw, raw[:end])

    def _guess(self, raw: bytes) -> None:
        """Take the latest stamp for the time until the graph's start is known."""
        try:
            self._latest_ns = max(self._latest_ns, parse(raw).stamp_ns)
        except SchemaMismatch:
            return

    def _on_first_frame(self, raw: bytes, name: bytes) -> None:
        """Take the first frame of a topic; a latched one has messages from before."""
        try:
            frame = parse(raw)
        except SchemaMismatch:
            return
        live = self.unmatched.pop(name)
        if live.name in self._new:
            self._sink.expect_from(live.name, frame.epoch, 1)
            return
        last = frame.sequence - (frame.kind == Kind.DATA)
        if self._from_start or not live.latched_depth or not last:
            return
        first = max(last - live.latched_depth, 0) + 1
        try:
            kept = self._reader.graph.history(live.node, live.name, first=first, last=last, timeout_s=1.0)
        except GraphError:
            return
        if kept:
            self._sink.expect_from(live.name, frame.epoch, kept[0].sequence)
        for one in kept:
            self._sink(self.now_ns(monotonic_ns()), raw_of(one))

    def _on_order(self, raw: bytes, name: bytes) -> None:
        """Expect what a node takes up after its written state, though it may have been published before."""
        try:
            frame = parse(raw)
            if frame.kind != Kind.DATA:
                return
            order = decode(Order, frame.payload)
            if not order.hand_over:
                return
            consumed = decode_any(HandOver, order.hand_over).consumed
        except SchemaMismatch:
            return
        self._orders_to_begin.discard(name)
        for topic in consumed.keys() & self._topics.keys():
            if consumed[topic].epoch >= 0:
                self._sink.expect_from(topic, consumed[topic].epoch, consumed[topic].sequence + 1)

    def _send_question(self, topic: str, question: _Question) -> None:
        live = self._topics.get(topic)
        if live is None:
            return
        self._questions[topic] = question._replace(asked_ns=monotonic_ns())
        try:
            serve = self._reader.server(topic) or self._reader.graph.node(live.node).serve
        except GraphError:
            return
        self._requester.ask_history(serve, topic, question.first, question.last)

    def _take_answers(self) -> None:
        now_ns = monotonic_ns()
        for reply in self._requester.replies():
            question = self._questions.pop(reply.get("topic", ""), None)
            if question is not None:
                self._answered_ns = now_ns
                self._take_answer(reply, question, now_ns)
        for topic, question in list(self._questions.items()):
            if now_ns - question.asked_ns > ANSWER_NS:
                del self._questions[topic]
        for topic, waiting in list(self._waiting.items()):
            if topic not in self._questions:
                self._send_question(topic, waiting.popleft())
                if not waiting:
                    del self._waiting[topic]

    def _take_answer(self, reply: dict[str, object], question: _Question, now_ns: int) -> None:
        frames = reply.get("frames")
        if reply.get("epoch") != question.epoch or not isinstance(frames, list) or not frames:
            return
        for raw in frames:
            self._sink.fill(self.now_ns(now_ns), raw)
        reached = parse(frames[-1]).sequence
        if question.first <= reached < question.last:  # a reply holds only so many bytes
            rest = question._replace(first=reached + 1)
            self._waiting.setdefault(str(reply["topic"]), deque()).appendleft(rest)


def is_order(name: str) -> bool:
    """Tell whether a topic carries what a node consumes in which order."""
    return name.endswith(f"/{ORDER_PORT}")


def recorded_nodes(graph: RunningGraph) -> list[str]:
    """Return the nodes of a running graph but its recorders: none records itself, or waits for another."""
    return [node.name for node in graph.record.nodes if node.run != RECORDER]


def live_topics(graph: RunningGraph) -> dict[str, Topic]:
    """Return the topics of a running graph by name, the hidden and the launcher's too, but no recorder's."""
    recorders = {node.name for node in graph.record.nodes if node.run == RECORDER}
    return {topic.name: topic for topic in graph.topics(include_hidden=True) if topic.node not in recorders}
