"""One process's part in a hot swap: the predecessor's, who hands in, or the successor's, who takes over.

Whoever drives the node asks it to :meth:`SwapParticipant.handle` what the supervisor says.
"""

from collections.abc import Callable
from typing import Any

import msgspec

from palp_core.errors import PalpError, in_words
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.frame import topic_of
from palp_core.graph.messages.message import decode_any, encode_any
from palp_core.graph.messages.schema import json_schema, schema_of
from palp_core.graph.messages.schema_reader import array_fields
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.process import swap_messages
from palp_core.graph.process.channel import ChannelMessage
from palp_core.graph.process.probation import FirstWork
from palp_core.graph.process.rehearsal import rehearse
from palp_core.graph.process.shadow import ShadowComparison
from palp_core.graph.transport.migration import Move
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.graph.transport.offsets import ReceivedOffsets
from palp_core.graph.transport.subscriber_socket import SubscriberSocket

READERS_NS = 300_000_000
"""How long readers that are no nodes of the graph may take to listen to a second place (assumed: a terminal
that is stopped must not keep a node from its swap)."""


class SwapParticipant:
    """A node's part in a swap.

    Args:
        executor: The node.
        sockets: Where it publishes.
        say: Answers the supervisor.
        heard: Returns up to where the inputs have been received.
        succeed: Merges what this process has received with what was handed over, and with up to where the
            predecessor has heard; returns how many messages wait.
        begin: Is told the graph's start before the node takes over.
        depart: Stops listening to the inputs.
        supervisor: Descriptor of the channel to the supervisor.
        successor: This process waits for its word.
    """

    def __init__(
        self,
        executor: Executor,
        sockets: NodeSockets,
        say: Callable[[ChannelMessage], None],
        supervisor: int,
        *,
        heard: Callable[[], ReceivedOffsets] = dict[str, tuple[int, int]],
        succeed: Callable[[HandOver, ReceivedOffsets], int] = lambda hand_over, _: len(hand_over.inbox),
        begin: Callable[[int], None] = lambda _: None,
        depart: Callable[[], None] = lambda: None,
        successor: bool = False,
    ) -> None:
        self._executor, self._sockets, self._say, self._supervisor = executor, sockets, say, supervisor
        self._heard, self._succeed, self._begin, self._depart = heard, succeed, begin, depart
        self._place: swap_messages.Place | None = None
        self._hand_in: swap_messages.HandIn | None = None
        self._meet: tuple[swap_messages.Meet, int] | None = None
        self._first_work: FirstWork | None = None
        self._commit: swap_messages.Commit | None = None
        self._report_request: swap_messages.CommitNow | None = None
        self._paused_ns, self._gap_s = 0, 0.0
        self._comparison: ShadowComparison | None = None
        self._eavesdropper: SubscriberSocket | None = None
        self.silent = successor
        self.left = False
        if successor:
            sockets.publisher.hold()
            sockets.publisher.greeting = lambda _: []

    @property
    def waiting(self) -> bool:
        """True while :meth:`turn` has to look."""
        waiting = (self._hand_in, self._meet, self._eavesdropper, self._report_request)
        return any(one is not None for one in waiting)

    def handle(self, message: swap_messages.ToSwapped) -> None:
        """Do what the supervisor says."""
        match message:
            case swap_messages.Place():
                self._place = message
                self._sockets.publisher.greeting = lambda publisher: [
                    publisher.heartbeat(),
                    self._moved(publisher, "prepare"),
                ]
                self._sockets.publisher.send_past_hold(self._moved_all("prepare"))
                self._say(swap_messages.Announced(self._sockets.publisher.readers))
            case swap_messages.HandIn():
                self._hand_in = message
            case swap_messages.Resume():
                self._hand_in = None
                self._resume()
            case swap_messages.Stay():
                self._sockets.publisher.send_past_hold(self._moved_all("stay"))
                self._sockets.publisher.greeting = lambda publisher: [publisher.heartbeat()]
                self._place = None
            case swap_messages.Leave(patience_ns=patience_ns):
                self._leave(patience_ns)
            case swap_messages.Meet():
                self._meet = message, monotonic_ns() + READERS_NS
            case swap_messages.Rehearse():
                self._say(self._rehearse(message))
            case swap_messages.TakeOver():
                self._say(self._take_over(message))
            case swap_messages.Go():
                self._go(message)
            case swap_messages.Bury():
                self._tell_readers("gone")
            case swap_messages.Shadow():
                self._say(self._begin_shadow(message))
            case swap_messages.EndShadow():
                self._say(self._end_shadow())
            case swap_messages.Commit():
                self._pass_on(message)
            case swap_messages.CommitNow():
                self._report_request = message
        self.turn()

    def turn(self) -> None:
        """Look whether what was waited for has come."""
        if self._hand_in is not None and _covers(self._heard(), self._hand_in.after):
            asked, self._hand_in = self._hand_in, None
            succession, remembered = self._executor.succession, self._sockets.requests.remembered
            if asked.pause:
                succession.pause()
            at_ns = monotonic_ns()
            found = succession.hand_over() if asked.pause else succession.copy(with_latest=asked.with_latest)
            self._say(swap_messages.HandedIn(encode_any(found), at_ns, remembered, self._heard()))
        if self._meet is not None:
            self._sockets.poll()
            meet, until_ns = self._meet
            missing = _missing(meet.readers, self._sockets.publisher.readers)
            complete = self._sockets.publisher.named_readers >= set(meet.nodes)
            if complete and (not missing or monotonic_ns() >= until_ns):
                self._meet = None
                self._say(swap_messages.Met(missing))
        if self._report_request is not None and self._first_work is not None:
            request = self._report_request
            if request.last or self._first_work.has_news or monotonic_ns() >= request.until_ns:
                self._report_request = None
                self._commit_work(last=request.last)
        if self._eavesdropper is not None and self._comparison is not None:
            for raw in self._eavesdropper.receive():
                self._comparison.old(raw)

    # Predecessor

    def _moved(self, publisher: PublisherEnd[Any], phase: str) -> bytes:
        assert self._place is not None
        return publisher.moved(encode_any(Move(phase, self._place.publish, self._place.serve)))

    def _moved_all(self, phase: str) -> list[bytes]:
        if self._place is None:
            return []
        readers = self._sockets.publisher.readers
        return [
            self._moved(out, phase) for name, out in self._executor.ends.publishers.items() if name in readers
        ]

    def _pass_on(self, commit: swap_messages.Commit) -> None:
        """Say what the successor has to say, and know where to go on should it fail."""
        error = ""
        try:
            self._executor.succession.fitting(decode_any(HandOver, commit.hand_over), {})
            self._commit = commit
        except Exception as failure:  # noqa: BLE001 - migrate and adopt are the user's
            error = in_words(failure)
        publishers = self._executor.ends.publishers
        for frame in commit.frames:
            if end := publishers.get(topic_of(frame).decode()):  # what only the new class has nobody reads
                end.pass_on(frame)
        self._say(swap_messages.Published(error))

    def _resume(self) -> None:
        succession, commit = self._executor.succession, self._commit
        self._commit = None
        if commit is None or not succession.paused:
            succession.resume()
            return
        hand_over = decode_any(HandOver, commit.hand_over)
        succession.take_back(hand_over, commit.ends)
        self._succeed(hand_over, {})

    def _leave(self, patience_ns: int) -> None:
        """Send the readers away, and wait for those that are slow to go."""
        self._sockets.publisher.greeting = lambda publisher: [self._moved(publisher, "gone")]
        self._sockets.publisher.send_past_hold(self._moved_all("gone"))
        self._depart()
        self._sockets.wait_until_unread(patience_ns, self._supervisor)
        self._executor.succession.leave()
        self.left = True

    # Successor

    def _rehearse(self, message: swap_messages.Rehearse) -> swap_messages.Rehearsed:
        error, tried, succession = "", b"", self._executor.succession
        try:
            hand_over = decode_any(HandOver, message.hand_over)
            succession.fitting(hand_over, message.params)
            if message.try_out:
                tried = encode_any(rehearse(self._executor, hand_over, message.params))
                self._sockets.publisher.hold()  # what it has published then is forgotten
        except Exception as failure:  # noqa: BLE001 - migrate, adopt and handlers are the user's
            error = in_words(failure)
        return swap_messages.Rehearsed(error, self._heard(), tried)

    def _take_over(self, message: swap_messages.TakeOver) -> swap_messages.TookOver:
        try:
            self._begin(message.start_ns)
            hand_over = decode_any(HandOver, message.hand_over)
            if message.on_probation:
                self._first_work = FirstWork(self._executor, reports=message.start_ns > 0)
                if self._first_work.reports:
                    self._sockets.publisher.hold(self._first_work.frames.append)
            self._executor.succession.take_over(hand_over, message.params)
            self._sockets.requests.remember(message.remembered)
            held = self._succeed(hand_over, message.heard)
        except PalpError as error:
            return swap_messages.TookOver(in_words(error))
        self._paused_ns = message.at_ns if message.start_ns else 0
        if self._first_work is not None:
            self._first_work.begin()
            self._gap_s = self._since_pause_s()
        return swap_messages.TookOver("", held)

    def _since_pause_s(self) -> float:
        """Return how long ago the predecessor took up nothing more; in simulated time 0."""
        return (monotonic_ns() - self._paused_ns) / 1e9 if self._paused_ns else 0.0

    def _commit_work(self, *, last: bool = False) -> None:
        """Say what has been done, at a handler boundary; the last time, keep back what follows."""
        assert self._first_work is not None
        self._say(self._first_work.commit(last=last))
        if last and self._first_work.reports:
            self._sockets.publisher.hold()
        if last:
            self._first_work = None

    @property
    def shadowing(self) -> bool:
        """True while this node works unheard."""
        return self._comparison is not None

    @property
    def on_probation(self) -> bool:
        """True while its predecessor may have to go on from where this node has come."""
        return self._first_work is not None

    def _begin_shadow(self, message: swap_messages.Shadow) -> swap_messages.TookOver:
        """Work on a copy of what the predecessor has; what is published is compared and goes nowhere."""
        published = decode_any(HandOver, message.hand_over).published
        publishers = self._executor.ends.publishers.items()
        arrays = {name: array_fields(json_schema(schema_of(out.message))) for name, out in publishers}
        self._comparison = ShadowComparison(published, arrays)
        self._sockets.publisher.hold(self._comparison.new)
        if message.publish:
            places = dict.fromkeys(published, message.publish)
            self._eavesdropper = SubscriberSocket(places, self._sockets.context, queue=100_000)
        return self._take_over(
            swap_messages.TakeOver(message.hand_over, message.params, message.start_ns, message.heard, {})
        )

    def _end_shadow(self) -> swap_messages.Shadowed:
        assert self._comparison is not None
        self._executor.succession.step_back()
        self.turn()
        report = b""
        if self._eavesdropper is not None:
            self._eavesdropper.close()
            self._eavesdropper = None
            report = msgspec.json.encode(self._comparison.report())
        self._comparison = None
        self._sockets.publisher.hold()
        return swap_messages.Shadowed(report, self._heard())

    def _go(self, message: swap_messages.Go) -> None:
        self.silent = False
        sockets = self._sockets
        sockets.publisher.greeting = lambda publisher: [publisher.heartbeat()]
        self._tell_readers("here")
        sockets.publisher.release()
        gap_s = self._gap_s or self._since_pause_s()
        record = {**message.record, "gap_s": gap_s, "held": len(self._executor.inbox)}
        self._executor.swaps.append(record)
        self._say(swap_messages.Working(record))

    def _tell_readers(self, phase: str) -> None:
        """Tell all who listen here that this is the place where everything goes on."""
        told = encode_any(Move(phase, *self._sockets.endpoints))
        readers = self._sockets.publisher.readers
        self._sockets.publisher.send_past_hold(
            out.moved(told) for name, out in self._executor.ends.publishers.items() if name in readers
        )


def _covers(heard: ReceivedOffsets, after: ReceivedOffsets) -> bool:
    return all(heard.get(topic, (-1, 0)) >= point for topic, point in after.items())


def _missing(expected: dict[str, int], present: dict[str, int]) -> dict[str, int]:
    counts = {name: count - present.get(name, 0) for name, count in expected.items()}
    return {name: count for name, count in counts.items() if count > 0}
