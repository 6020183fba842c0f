"""The swap as a table of steps, make before break: each sends a message, waits for the answer, can be undone.

Two processes of a node and two executors of a composed graph are swapped alike: both are participants
(:mod:`palp_core.graph.process.swap_participant`), reached by a channel or in memory. Until the new node
receives ``Commit`` it publishes nothing by itself, so that there is one owner at every instant.
"""

import contextlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import msgspec

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.lockstep.conductor import Conductor
from palp_core.graph.messages.frame import topic_of
from palp_core.graph.messages.message import decode_any
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.loading import endpoints
from palp_core.graph.node.spec import HUNG_S
from palp_core.graph.process.control_messages import Configured, Done, Matched, Round
from palp_core.graph.process.shadow import ShadowComparison
from palp_core.graph.process.swap_messages import (
    HANDLER,
    AnnounceSuccessor,
    AwaitReaders,
    CancelMove,
    Commit,
    DryRun,
    DryRunResult,
    EndShadow,
    Handover,
    Leave,
    Published,
    ReadersReady,
    RequestHandover,
    RequestReport,
    Resume,
    Shadowed,
    SuccessorAnnounced,
    TakeOver,
    TookOver,
    Working,
    WorkReport,
)
from palp_core.graph.supervision.supervisor import FAREWELL_NS, Supervisor
from palp_core.graph.swap.step_engine import LARGE_BYTES, NEW, OLD, Step, StepEngine, SwapHost
from palp_core.graph.swap.swap import CheckedSwap, SwapFailed, SwapReport, why_not_swappable
from palp_core.graph.transport.restart_files import ReceivedOffsets

LINGER_NS = 60_000_000_000
"""How long an old process stays for a reader that is stopped or slow (assumed)."""

LOOK_NS = 10_000_000
"""Simulated time: how often it is asked whether a probation is over."""

ALWAYS, WITH_SHADOW, ON_PROBATION = "", "with a shadow", "on probation"
"""When a step is part of a swap."""


class Swap(StepEngine):
    def __init__(
        self, host: SwapHost, folder: Path, swap: CheckedSwap, now_ns: int, conductor: Conductor | None
    ) -> None:
        super().__init__(host, folder, swap)
        self._now_ns, self._conductor = now_ns, conductor
        self._begun_ns = monotonic_ns()
        self._wall = bool(host.start_ns)
        self._after: ReceivedOffsets = {}
        self._on_probation = self._can_roll_back = False
        self._probation_end_ns = 0
        self._report_request = RequestReport()
        self._latest = WorkReport(b"", [], 0, -1, HANDLER)
        self._unpublished: list[bytes] = []
        self._last_frames: list[bytes] = []
        self._comparison: dict[str, Any] = {}
        self._rounds = Rounds(topic.encode() for topic in swap.new.inputs.values())

    def run(self) -> tuple[SwapReport, Done | None]:
        """Walk the table; before the commit a failure leaves all as it was."""
        if why := self._impediment():
            self._fail(why)
        try:
            self._walk(PREPARATION)
            if self._request.dry_run:
                self._roll_back()
                return self._report(Working(0.0, 0)), None
            self._walk(CHANGE)
            if self._on_probation and not self._wall:
                self._pass_probation()
            while self._on_probation and self._wall and not self._latest.last:
                self._walk(PROBATION)
            if not self._committed:
                self._walk(COMMIT)
        except BaseException as error:
            if not self._committed:
                self._roll_back()
                if isinstance(error, SwapFailed):
                    self._hand_on_last_frames()
            raise
        self._walk(LEAVE)
        taken = self._answer(TookOver)
        done = Done(self._take_last_frames() + taken.frames, taken.next_due_ns, None)
        return self._report(self._answer(Working)), None if self._on_probation else done

    def _take_last_frames(self) -> list[bytes]:
        """Return what the old node has published with its last copy, once."""
        frames, self._last_frames = self._last_frames, []
        return frames

    def _hand_on_last_frames(self) -> None:
        """Publish, in simulated time, what the old node has published with a copy that was not taken over."""
        frames = self._take_last_frames()
        if frames and self._conductor is not None and not self._old.ended:
            done = self._host.work_together({self.index: Round(self._conductor.now_ns, [])})[self.index]
            self._conductor.accept(self.index, msgspec.structs.replace(done, frames=frames + done.frames))

    def _walk(self, steps: tuple[Step, ...]) -> None:
        parts = {ALWAYS: True, WITH_SHADOW: self._request.shadow_s > 0.0, ON_PROBATION: True}
        for step in steps:
            parts[ON_PROBATION] = self._on_probation
            if parts[step.when]:
                self.take(step)

    def _report(self, working: Working) -> SwapReport:
        return self._swap.report(
            at_ns=self._now_ns,
            gap_s=working.gap_s,
            held=working.held,
            duration_s=(monotonic_ns() - self._begun_ns) / 1e9 if self._wall else 0.0,
            shadow=self._comparison,
            proven=self._latest.proof_count,
            proven_by=self._latest.proof,
        )

    # Start and configure

    def _impediment(self) -> str:
        """Return which of the nodes that a swap needs is absent just now; "" if none is."""
        if absence := self._old.absence():
            return f"the node itself {absence}"
        if not self._wall:
            return ""  # in simulated time no node listens to sockets
        readers = self._readers()
        publishers = {name.split("/")[1] for name in self._swap.new.inputs.values()}
        for process in self._host.processes:
            name = process.spec.name
            absence = process.absence() if name in readers | publishers else ""
            if absence:
                what = "which reads it" if name in readers else "which it reads"
                return f"/{name}, {what}, {absence}"
        return ""

    def _readers(self) -> set[str]:
        edges = self._swap.checked.edges.items()
        node = self._request.node
        return {reader for name, ends in edges if name.split("/")[1] == node for reader, _ in ends}

    def request_copy(self) -> RequestHandover:
        return RequestHandover(self._after, pause=False)

    def judge_running(self, step: Step) -> None:
        running = decode_any(HandOver, self.wait_for_answer(step).hand_over)
        if why := why_not_swappable(running, self._swap):
            self._fail(why)
        self._on_probation = self._swap.probation.run_count > 0 and running.active

    def start_successor(self) -> None:
        spec = self._old.successor_spec(self._swap.new)
        self._standby = self._host.standbys.start(spec, self._old.log, fresh=True)
        self._successor = self._standby.process

    def send_nothing(self) -> None: ...

    # Connect

    def announce_successor(self) -> AnnounceSuccessor:
        return AnnounceSuccessor(*endpoints(str(self._folder), self._new.process.place))

    def await_readers(self) -> AwaitReaders:
        return AwaitReaders(self._answer(SuccessorAnnounced).readers, self._nodes_that_read())

    def _nodes_that_read(self) -> list[str]:
        """Return the graph's own readers that work; in simulated time none listens."""
        readers = self._readers() if self._wall else set()
        processes = self._host.processes
        return sorted(
            process.spec.name for process in processes if process.active and process.spec.name in readers
        )

    def wait_for_readers(self, step: Step) -> None:
        names = ", ".join(f"/{name}" for name in self._nodes_that_read())
        text = f"not every reader listened at the new place; one is stopped or busy: {names}"
        self.wait_for_answer(step, missing=text)

    # State

    def request_copy_to_try(self) -> RequestHandover:
        return RequestHandover({}, pause=False, with_latest=self._swap.try_out)

    def try_state(self) -> DryRun:
        return DryRun(self._answer(Handover).hand_over, self._request.params, self._on_probation)

    def keep_offsets(self, step: Step) -> None:
        self._after = self.wait_for_answer(step).after

    def try_way_back(self) -> DryRun:
        return DryRun(self._answer(DryRunResult).tried, {})

    def judge_way_back(self, step: Step) -> None:
        self._can_roll_back = not self.wait_for_answer(step, may_refuse=True).error

    # Shadow, hand over and take over

    def begin_shadow(self) -> TakeOver:
        publish = endpoints(str(self._folder), self._old.place)[0] if self._wall else ""
        return TakeOver(self._answer(Handover), self._request.params, self._host.start_ns, shadow=publish)

    def let_both_work(self, step: Step) -> None:
        self.wait_for_answer(step)
        new, begun_ns = self._new, monotonic_ns()
        duration_ns = round(self._request.shadow_s * 1e9)
        self._deadline_ns += duration_ns
        if self._wall:
            self._host.wait_until(lambda: bool(new.failure) or self._old.ended, begun_ns + duration_ns)
            return
        running = decode_any(HandOver, self._answer(Handover).hand_over)
        self._rounds.comparison = comparison = self._swap.comparison(running.published)
        with self._taking_rounds() as conductor:
            conductor.run(conductor.now_ns + duration_ns)
        self._rounds.comparison = None
        self._deadline_ns += monotonic_ns() - begun_ns
        self._now_ns += duration_ns
        self._comparison = comparison.report()

    def end_shadow(self) -> EndShadow:
        return EndShadow()

    def keep_comparison(self, step: Step) -> None:
        shadowed = self.wait_for_answer(step)
        self._after = shadowed.after
        if shadowed.report:
            self._comparison = msgspec.json.decode(shadowed.report)

    def request_last_copy(self) -> RequestHandover:
        return RequestHandover(self._after, pause=True)

    def free_old(self, step: Step) -> None:
        """Let the old process end from now on: it has handed over everything."""
        handover = self.wait_for_answer(step)
        self._old.handed_over, self._last_frames = True, handover.frames
        if self._wall:
            self._now_ns = handover.at_ns - self._host.start_ns

    def take_over(self) -> TakeOver:
        return TakeOver(self._answer(Handover), self._request.params, self._host.start_ns, self._on_probation)

    # Probation

    def begin_probation(self, step: Step) -> None:
        self.wait_for_answer(step)
        self._probation_end_ns = monotonic_ns() + round(self._swap.standby_s * 1e9)

    def request_report(self) -> RequestReport:
        """Ask for one report: the last, if the new node is proven or the old one can publish none.

        Where the old one could not go on from a report, the first that counts a handler is the last. In
        simulated time there is one after each round, at once.
        """
        if not self._wall:
            self._report_request = RequestReport()
        elif self._is_proven() or self._must_end() or monotonic_ns() >= self._probation_end_ns:
            self._report_request = RequestReport(last=True)
        elif self._can_roll_back:
            self._report_request = RequestReport(self._probation_end_ns)
        else:
            self._report_request = RequestReport(self._probation_end_ns, handler_count=1, last=True)
        return self._report_request

    def _is_proven(self) -> bool:
        enough = self._latest.proof_count >= self._swap.probation.run_count
        return enough if self._can_roll_back else self._latest.run_count > 0

    def _must_end(self) -> bool:
        return self._old.ended or self._host.exit_code is not None

    def keep_report(self, step: Step) -> None:
        """Wait for the report; if the probation must end meanwhile, for the last one."""
        if not self._wall:
            report = self._await(NEW, WorkReport, "a handler of it did not return", HUNG_S["sim"])
            frames = [*self._rounds.take_held(), *report.frames]
            self._answers[WorkReport] = msgspec.structs.replace(report, frames=frames)
            return
        if not self._wait_for_report():
            self._report_request = RequestReport(last=True)
            self._send(NEW, self._report_request)
            self._wait_for_report()
        replies = list(self._successor.replies)
        self._successor.replies.clear()
        self._check_successor()
        reports = [reply for reply in replies if isinstance(reply, WorkReport)]
        frames = [frame for report in reports for frame in report.frames]
        self._answers[step.awaits] = msgspec.structs.replace(reports[-1], frames=frames)

    def _wait_for_report(self) -> bool:
        host, new, request = self._host, self._new, self._report_request
        assert isinstance(host, Supervisor)

        def has_report() -> bool:
            reports = (reply for reply in self._successor.replies if isinstance(reply, WorkReport))
            return bool(new.failure) or any(report.last == request.last for report in reports)

        def is_over() -> bool:
            return has_report() or (request.until_ns > 0 and self._must_end())

        limit_s = HUNG_S["wall"]
        if self._state_bytes() > LARGE_BYTES:  # to write it down takes time, too
            limit_s = max(limit_s, self._request.timeout_s)
        hung_ns = max(request.until_ns, monotonic_ns()) + round(limit_s * 1e9)
        incoming_bytes = host.standbys.incoming_bytes
        if not host.wait_until(lambda: is_over() or incoming_bytes(new) > 0, hung_ns):
            self._fail_in_time("a handler of it did not return", limit_s)
        self._extend_deadline()
        self._wait_for(is_over, "it did not report its state")
        return has_report()

    def pass_on(self) -> WorkReport:
        self._latest = self._answer(WorkReport)
        return self._latest

    def judge_publication(self, step: Step) -> None:
        """Wait until the old node has published the report; if it has died, the new one does in the end."""

        def is_over() -> bool:
            return self._found(OLD, Published) is not None or self._old.ended

        self._extend_deadline()
        if self._can_roll_back:
            self._wait_for(is_over, "the old node did not publish a report")
        else:
            self._host.wait_until(is_over, self._deadline_ns)
        answer = self._found(OLD, Published)
        if answer is None and self._old.ended:
            self._unpublished += self._latest.frames
        self._can_roll_back &= answer is not None and not answer.error
        self._must_commit = not self._can_roll_back and (self._latest.last or not self._wall)

    # Rounds of simulated time, while both nodes are there

    @contextlib.contextmanager
    def _taking_rounds(self) -> Iterator[Conductor]:
        """Have the node's rounds go by :meth:`work`."""
        assert self._conductor is not None
        self._host.swap = self
        try:
            yield self._conductor
        finally:
            self._host.swap = None

    def work(self, message: Round) -> Done:
        """Do the node's part of a round: let both work and compare, or the new one, or else the old one."""
        rounds, index = self._rounds, self.index
        if rounds.comparison is not None:
            self._host.standbys.send(self._new, message)
            done = self._host.work_together({index: message})[index]
            with contextlib.suppress(SwapFailed):  # the next step says so
                rounds.compare(done, self._await(NEW, Done, "a round of it did not end", HUNG_S["sim"]))
            return done
        own, others = rounds.split(message)
        if self._committed:
            return self._host.work_together({index: own})[index]
        if rounds.failure is None and (tried := self._try(own)) is not None:
            rounds.passed_by += others
            return tried
        if not rounds.rolled_back:
            rounds.rolled_back = True
            self._roll_back()
        passed_by, rounds.passed_by = rounds.passed_by, []
        whole = Round(message.now_ns, [*passed_by, *message.frames])
        return self._host.work_together({index: whole})[index]

    @property
    def holds_requests(self) -> bool:
        """Whether it is not clear yet who goes on as the node: what tools ask of it waits."""
        return self._on_probation and self._rounds.comparison is None

    def _try(self, message: Round) -> Done | None:
        """Let the new node do a round, and report it; None if it failed: the round has not happened."""
        try:
            self._check_successor()
            self._host.standbys.send(self._new, message)
            done = self._await(NEW, Done, "a handler of it did not return", HUNG_S["sim"])
            self._rounds.held += done.frames
            self._walk(PROBATION)
        except SwapFailed as failure:
            self._rounds.failure = failure
            return None
        self._commit_if_proven()
        return msgspec.structs.replace(done, frames=self._latest.frames)

    def _commit_if_proven(self) -> None:
        """Let the new node go on by itself if it is proven, or if the old one cannot take its state."""
        enough = self._latest.proof_count >= self._swap.probation.run_count
        if enough or not self._can_roll_back:
            self._commit_between_rounds()

    def _commit_between_rounds(self) -> None:
        try:
            self._walk(COMMIT)
        except SwapFailed as failure:  # the last round has happened: the old node goes on after it
            self._rounds.failure = failure

    def _begin_rounds(self) -> Done:
        """Return what both have published at the change of hands, as far as it cannot be taken back."""
        taken = self._answer(TookOver)
        frames = self._take_last_frames()
        self._rounds.held = list(taken.frames)
        if self._can_roll_back:
            try:
                self._walk(PROBATION)
                frames += self._latest.frames
                if not self._can_roll_back:
                    self._commit_if_proven()
            except SwapFailed as failure:
                self._rounds.failure = failure
        return Done(frames, taken.next_due_ns, None)

    def _pass_probation(self) -> None:
        """Let simulated time go by until it is clear who goes on, or until its limit or the run's end."""
        self.step = "probation"
        rounds, longest_s = self._rounds, self._swap.probation.longest_s
        with self._taking_rounds() as conductor:
            conductor.accept(self.index, self._begin_rounds())
            end_ns = None if longest_s is None else conductor.now_ns + round(longest_s * 1e9)
            latest_ns = monotonic_ns() + round(self._request.timeout_s * 1e9)
            while not (
                self._committed or rounds.failure or self._new.failure or conductor.exit_code is not None
            ):
                before_ns = conductor.now_ns
                if monotonic_ns() > latest_ns if end_ns is None else before_ns >= end_ns:
                    break
                next_ns = before_ns + LOOK_NS
                conductor.run(next_ns if end_ns is None else min(next_ns, end_ns))
                if conductor.now_ns == before_ns:  # the run ends at a time, and this is it
                    break
            if not (self._committed or rounds.failure):
                self._commit_between_rounds()
            if not (self._committed or rounds.rolled_back):  # it failed between two rounds
                conductor.accept(self.index, self.work(Round(conductor.now_ns, [])))
        if rounds.failure is not None and not self._committed:
            raise rounds.failure

    # Commit and leave

    def commit(self) -> Commit:
        runs = {"before": self._swap.old.run, "after": self._swap.new.run}
        return Commit({"at_s": self._now_ns / 1e9, **runs}, self._unpublished)

    def promote(self, step: Step) -> None:
        """Give the new node the part; if it fails from now on, the node has failed."""
        host, new = self._host, self._new
        self._committed = True
        host.promote(self.index, new)
        host.wait_until(
            lambda: self._found(NEW, Working) is not None or self._successor.ended,
            monotonic_ns() + FAREWELL_NS,
        )
        held = self._answer(TookOver).held
        self._answers[Working] = self._found(NEW, Working) or Working(0.0, held)

    def send_away(self) -> Leave:
        return Leave(LINGER_NS)

    def retire_old(self, _: Step) -> None:
        """Let the node's name lead to the new process, once the old one's readers have all and it ends."""
        self._host.retire(self.index, self._new)


class Rounds:
    """What is between two nodes that share the rounds of simulated time."""

    def __init__(self, inputs: Iterable[bytes]) -> None:
        self._inputs = set(inputs)
        self.comparison: ShadowComparison | None = None  # while both work
        self.held: list[bytes] = []  # what the new node has published and not reported
        self.passed_by: list[bytes] = []  # what it does not read: it waits for the old one
        self.failure: SwapFailed | None = None  # why the old one goes on
        self.rolled_back = False  # the old one works again

    def split(self, message: Round) -> tuple[Round, list[bytes]]:
        own = [frame for frame in message.frames if topic_of(frame) in self._inputs]
        others = [frame for frame in message.frames if topic_of(frame) not in self._inputs]
        return Round(message.now_ns, own), others

    def take_held(self) -> list[bytes]:
        held, self.held = self.held, []
        return held

    def compare(self, old: Done, new: Done) -> None:
        assert self.comparison is not None
        for frame in old.frames:
            self.comparison.old(frame)
        for frame in new.frames:
            self.comparison.new(frame)


PREPARATION = (
    Step("start", ALWAYS, OLD, Swap.request_copy, Handover, Swap.judge_running),
    Step("configure", ALWAYS, NEW, Swap.start_successor, Configured),
    Step("configure", ALWAYS, NEW, Swap.send_nothing, Matched),
    Step("connect", ALWAYS, OLD, Swap.announce_successor, SuccessorAnnounced, undo=CancelMove()),
    Step("connect", ALWAYS, NEW, Swap.await_readers, ReadersReady, Swap.wait_for_readers),
    Step("state", ALWAYS, OLD, Swap.request_copy_to_try, Handover),
    Step("state", ALWAYS, NEW, Swap.try_state, DryRunResult, Swap.keep_offsets),
    Step("state", ON_PROBATION, OLD, Swap.try_way_back, DryRunResult, Swap.judge_way_back),
    Step("shadow", WITH_SHADOW, OLD, Swap.request_copy, Handover),
    Step("shadow", WITH_SHADOW, NEW, Swap.begin_shadow, TookOver, Swap.let_both_work),
    Step("shadow", WITH_SHADOW, NEW, Swap.end_shadow, Shadowed, Swap.keep_comparison),
)
"""The steps in which the old node works; a dry run ends here."""

CHANGE = (
    Step("hand over", ALWAYS, OLD, Swap.request_last_copy, Handover, Swap.free_old, Resume()),
    Step("take over", ALWAYS, NEW, Swap.take_over, TookOver, Swap.begin_probation),
)
"""The steps in which neither works."""

PROBATION = (
    Step("probation", ON_PROBATION, NEW, Swap.request_report, WorkReport, Swap.keep_report),
    Step("probation", ON_PROBATION, OLD, Swap.pass_on, Published, Swap.judge_publication),
)
"""What is repeated until the new node is proven: one report at a time, so that nothing overtakes it."""

COMMIT = (Step("commit", ALWAYS, NEW, Swap.commit, Working, Swap.promote),)
"""From here on nothing is undone."""

LEAVE = (Step("leave", ALWAYS, OLD, Swap.send_away, Done, Swap.retire_old),)

TABLE = (*PREPARATION, *CHANGE, *PROBATION, *COMMIT, *LEAVE)
