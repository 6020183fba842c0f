"""One process's part in a hot swap: the predecessor's, or that of the successor which takes over."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import msgspec

from palp_core.errors import NodeError, PalpError, SchemaMismatch, in_words
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.frame import topic_of
from palp_core.graph.messages.message import decode_any, encode_any
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.messages.schema_reader import array_fields
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver
from palp_core.graph.process import swap_messages
from palp_core.graph.process.channel import ChannelMessage
from palp_core.graph.process.shadow import ShadowComparison
from palp_core.graph.transport.migration import Move
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.graph.transport.receiver import TopicReceiver
from palp_core.graph.transport.restart_files import ReceivedOffsets
from palp_core.graph.transport.subscriber_socket import SubscriberSocket

READERS_NS = 300_000_000
"""How long readers that are no nodes of the graph may take to listen to a second place (assumed: a terminal
that is stopped must not keep a node from its swap)."""


class SharedSockets:
    """What a composed node has of the sockets of its process: its readers stay where they are in a swap."""

    endpoints = "", ""
    context: Any = None

    def __init__(self, shared: NodeSockets | None) -> None:
        self.publisher = self.requests = self
        self.readers: dict[str, int] = {}
        self.named_readers: set[str] = set()
        self.remembered: dict[str, bytes] = {}
        self.beats, self.announcement = True, b""
        self._shared = shared.publisher if shared is not None else None
        self._held: Callable[[bytes], object] | None = None
        self._kept_back: list[bytes] = []

    @property
    def has_subscribers(self) -> bool:
        return self._shared is not None and self._shared.has_subscribers

    def send(self, frame: bytes) -> None:
        if self._held is not None:
            self._held(frame)
        elif self._shared is not None:
            self._shared.send(frame)

    def hold(self, instead: Callable[[bytes], object] | None = None) -> None:
        self._kept_back = []
        self._held = instead or self._kept_back.append

    def release(self) -> None:
        self._held = None
        self.send_past_hold(self._kept_back)

    def send_past_hold(self, frames: Iterable[bytes]) -> None:
        for frame in frames:
            if self._shared is not None:
                self._shared.send(frame)

    def remember(self, _: dict[str, bytes]) -> None:
        """Replies stay with the process."""

    def poll(self) -> None:
        """The process does."""

    def wait_until_unread(self, _: int, __: int) -> None:
        """No reader moves."""


class WorkReporter:
    """What a successor has done since it last reported."""

    def __init__(self, executor: Executor) -> None:
        self.frames: list[bytes] = []
        self._executor = executor
        self._begun_at = self._reported = 0

    def begin(self) -> None:
        """Count handlers from here on: the node has taken over."""
        self._begun_at = self._reported = self._executor.ends.run_count()

    def has_news(self, handler_count: int = 0) -> bool:
        """Return whether there is something to report, and so many handlers have run."""
        run_count = self._executor.ends.run_count()
        is_new = bool(self.frames) or run_count != self._reported
        return is_new and run_count - self._begun_at >= handler_count

    def report(self, *, last: bool = False) -> swap_messages.WorkReport:
        """Report what has been done, at a handler boundary."""
        executor = self._executor
        if executor.exit_code is not None:
            raise NodeError(executor.name, "it called finish() on probation")
        executor.journal.flush(executor.now_ns())
        self._reported = executor.ends.run_count()
        frames = list(self.frames)
        self.frames.clear()
        written = executor.snapshot()  # the predecessor remembers the frames that it publishes
        try:
            executor.fitting(written, {})
        except SchemaMismatch as error:
            raise NodeError(executor.name, f"its state is not what its class declares: {error}") from error
        run_count, counter = self._reported - self._begun_at, executor.node.proven_by
        proof_count = getattr(executor.node, counter) if counter else run_count
        if type(proof_count) is not int or not 0 <= proof_count < 2**63:
            text = f"its {counter} is {proof_count!r:.60}; it must be a whole number of at least 0"
            raise NodeError(executor.name, text)
        return swap_messages.WorkReport(
            encode_any(written),
            frames,
            run_count,
            proof_count,
            counter.removesuffix("_count") or swap_messages.HANDLER,
            last,
            list(executor.ends.timed),
        )


class SwapParticipant:
    """A node's part in a swap."""

    def __init__(
        self,
        executor: Executor,
        sockets: NodeSockets | SharedSockets,
        answer: Callable[[ChannelMessage], None],
        supervisor: int,
        *,
        receiver: TopicReceiver | None = None,
        set_start: Callable[[int], None] = lambda _: None,
        successor: bool = False,
    ) -> None:
        self._executor, self._sockets, self._answer, self._supervisor = executor, sockets, answer, supervisor
        self._receiver, self._set_start = receiver, set_start
        self._successor = "", ""
        self._pending: dict[type[ChannelMessage], swap_messages.ToSwapped] = {}
        self._readers_until_ns = 0
        self._reporter: WorkReporter | None = None
        self._last_report: swap_messages.WorkReport | None = None
        self._paused_ns, self._gap_s = 0, 0.0
        self._comparison: ShadowComparison | None = None
        self._eavesdropper: SubscriberSocket | None = None
        self.silent = successor  # the node publishes nothing before it is committed
        self.left = False  # another process goes on with the node
        if successor:
            sockets.publisher.hold()
            sockets.publisher.beats = False

    def _received(self) -> ReceivedOffsets:
        return {} if self._receiver is None else self._receiver.received

    def _merge(self, hand_over: HandOver, received: ReceivedOffsets) -> int:
        """Merge what this process has received with a hand-over; return how many messages wait."""
        receiver = self._receiver
        return len(hand_over.inbox) if receiver is None else receiver.continue_from(hand_over, received)

    @property
    def waiting(self) -> bool:
        """True while :meth:`turn` has to look."""
        return bool(self._pending) or self._eavesdropper is not None

    def handle(self, message: swap_messages.ToSwapped) -> None:
        match message:
            case swap_messages.AnnounceSuccessor():
                self._announce(message)
            case swap_messages.RequestHandover() | swap_messages.RequestReport():
                self._pending[type(message)] = message
            case swap_messages.WorkReport():
                self._publish_report(message)
            case swap_messages.Resume():
                self._resume()
            case swap_messages.CancelMove():
                self._send_move("stay", self._successor)
                self._sockets.publisher.announcement = b""
            case swap_messages.Leave(patience_ns=patience_ns):
                self._leave(patience_ns)
            case swap_messages.AwaitReaders():
                self._pending[type(message)] = message
                self._readers_until_ns = monotonic_ns() + READERS_NS
            case swap_messages.DryRun():
                self._answer(self._try(message))
            case swap_messages.EndShadow():
                self._answer(self._end_shadow())
            case swap_messages.TakeOver():
                self._answer(self._take_over(message))
            case swap_messages.Commit():
                self._commit(message)
            case swap_messages.AnnouncePredecessorDead():
                self._send_move("gone", self._sockets.endpoints)
        self.turn()

    def turn(self) -> None:
        """Answer what could not be answered at once, if it can be now."""
        for message in list(self._pending.values()):
            if (answer := self._answer_to(message)) is not None:
                del self._pending[type(message)]
                self._answer(answer)
        if self._eavesdropper is not None and self._comparison is not None:
            for raw in self._eavesdropper.receive():
                self._comparison.old(raw)

    def _answer_to(self, message: swap_messages.ToSwapped) -> ChannelMessage | None:
        match message:
            case swap_messages.RequestHandover(after=after):
                return self._hand_over(message) if _covers(self._received(), after) else None
            case swap_messages.AwaitReaders():
                return swap_messages.ReadersReady() if self._has_readers(message) else None
            case swap_messages.RequestReport(last=last):
                return self._report(last=last) if self._report_is_due(message) else None
        return None

    def _send_move(self, phase: str, endpoints: tuple[str, str]) -> bytes:
        """Send every reader where a topic goes on; return the announcement."""
        payload = encode_any(Move(phase, *endpoints))
        publisher, ends = self._sockets.publisher, self._executor.ends.publishers
        publisher.send_past_hold(ends[name].moved(payload) for name in publisher.readers if name in ends)
        return payload

    # Predecessor

    def _announce(self, successor: swap_messages.AnnounceSuccessor) -> None:
        publisher = self._sockets.publisher
        self._successor = successor.publish, successor.serve
        publisher.announcement = self._send_move("prepare", self._successor)
        self._answer(swap_messages.SuccessorAnnounced(publisher.readers))

    def _hand_over(self, request: swap_messages.RequestHandover) -> swap_messages.Handover:
        executor = self._executor
        if request.pause:
            executor.pause()
        at_ns = monotonic_ns()
        found = (
            executor.hand_over() if request.pause else executor.full_snapshot(with_latest=request.with_latest)
        )
        return swap_messages.Handover(
            encode_any(found), at_ns, self._sockets.requests.remembered, self._received()
        )

    def _publish_report(self, report: swap_messages.WorkReport) -> None:
        """Publish what the successor has reported, and know where to go on should it fail."""
        error = ""
        try:
            self._executor.fitting(decode_any(HandOver, report.hand_over), {})
            self._last_report = report
        except Exception as failure:  # noqa: BLE001 - migrate and adopt are the user's
            error = in_words(failure)
        outputs = self._executor.ends.publishers
        for frame in report.frames:
            if end := outputs.get(topic_of(frame).decode()):  # what only the new class has is not read
                end.pass_on(frame)
        self._answer(swap_messages.Published(error))

    def _resume(self) -> None:
        self._pending.pop(swap_messages.RequestHandover, None)
        executor, report = self._executor, self._last_report
        self._last_report = None
        if report is None or not executor.paused:
            executor.resume()
            return
        hand_over = decode_any(HandOver, report.hand_over)
        executor.take_back(hand_over, report.ends)
        self._merge(hand_over, {})

    def _leave(self, patience_ns: int) -> None:
        """Send the readers away, and wait for those that are slow to go."""
        publisher = self._sockets.publisher
        publisher.announcement, publisher.beats = self._send_move("gone", self._successor), False
        if self._receiver is not None:
            self._receiver.close()
        self._sockets.wait_until_unread(patience_ns, self._supervisor)
        self._executor.leave()
        self.left = True

    # Successor

    def _has_readers(self, request: swap_messages.AwaitReaders) -> bool:
        self._sockets.poll()
        publisher = self._sockets.publisher
        counts = publisher.readers
        complete = all(counts.get(name, 0) >= count for name, count in request.readers.items())
        has_nodes = publisher.named_readers >= set(request.nodes)
        return has_nodes and (complete or monotonic_ns() >= self._readers_until_ns)

    def _try(self, message: swap_messages.DryRun) -> swap_messages.DryRunResult:
        error, tried = "", b""
        try:
            hand_over = decode_any(HandOver, message.hand_over)
            self._executor.fitting(hand_over, message.params)
            if message.try_out:
                tried = encode_any(self._executor.dry_run(hand_over, message.params))
                self._sockets.publisher.hold()  # what it has published then is forgotten
        except Exception as failure:  # noqa: BLE001 - migrate, adopt and handlers are the user's
            error = in_words(failure)
        return swap_messages.DryRunResult(error, self._received(), tried)

    def _take_over(self, message: swap_messages.TakeOver) -> swap_messages.TookOver:
        try:
            self._set_start(message.start_ns)
            hand_over = decode_any(HandOver, message.handover.hand_over)
            if message.shadow is not None:
                self._begin_shadow(message.shadow, hand_over.published)
            if message.on_probation:
                self._reporter = WorkReporter(self._executor)
                self._sockets.publisher.hold(self._reporter.frames.append)
            self._executor.take_over(hand_over, message.params)
            if self._executor.exit_code is not None:
                raise NodeError(self._executor.name, "it called finish() before it had taken over")
            if message.shadow is None:
                self._sockets.requests.remember(message.handover.remembered)
            held = self._merge(hand_over, message.handover.received)
        except PalpError as error:
            return swap_messages.TookOver(in_words(error))
        self._paused_ns = message.handover.at_ns if message.start_ns else 0
        if self._reporter is not None:
            self._reporter.begin()
            self._gap_s = self._since_pause_s()
        return swap_messages.TookOver("", held)

    def _since_pause_s(self) -> float:
        """Return how long ago the predecessor took up nothing more; in simulated time 0."""
        return (monotonic_ns() - self._paused_ns) / 1e9 if self._paused_ns else 0.0

    def _report_is_due(self, request: swap_messages.RequestReport) -> bool:
        is_late = monotonic_ns() >= request.until_ns
        return is_late or (self._reporter is not None and self._reporter.has_news(request.handler_count))

    def _report(self, *, last: bool) -> swap_messages.WorkReport | None:
        """Report what has been done, at a handler boundary; the last time, keep back what follows."""
        if self._reporter is None:
            return None
        report = self._reporter.report(last=last)
        if last:
            self._sockets.publisher.hold()
            self._reporter = None
        return report

    @property
    def is_unread(self) -> bool:
        """True while this node works, and its predecessor is read."""
        return self._comparison is not None or self._reporter is not None

    def _begin_shadow(self, publish: str, published: Mapping[str, int]) -> None:
        publishers = self._executor.ends.publishers.items()
        arrays = {name: array_fields(schema_of(out.message).json_schema) for name, out in publishers}
        self._comparison = ShadowComparison(published, arrays)
        self._sockets.publisher.hold(self._comparison.new)
        if publish:
            places = dict.fromkeys(published, publish)
            self._eavesdropper = SubscriberSocket(places, self._sockets.context, queue=100_000)

    def _end_shadow(self) -> swap_messages.Shadowed:
        assert self._comparison is not None
        self._executor.step_back()
        self.turn()
        report = b""
        if self._eavesdropper is not None:
            self._eavesdropper.close()
            self._eavesdropper = None
            report = msgspec.json.encode(self._comparison.report())
        self._comparison = None
        self._sockets.publisher.hold()
        return swap_messages.Shadowed(report, self._received())

    def _commit(self, message: swap_messages.Commit) -> None:
        self.silent = False
        self._pending.clear()  # the last report may have been asked for twice
        self._reporter = None
        publisher, executor = self._sockets.publisher, self._executor
        publisher.beats = True
        self._send_move("here", self._sockets.endpoints)
        publisher.send_past_hold(message.frames)
        publisher.release()
        working = swap_messages.Working(self._gap_s or self._since_pause_s(), len(executor.inbox))
        executor.swaps.append({**message.record, "gap_s": working.gap_s, "held": working.held})
        self._answer(working)


def _covers(received: ReceivedOffsets, after: ReceivedOffsets) -> bool:
    return all(received.get(topic, (-1, 0)) >= point for topic, point in after.items())
