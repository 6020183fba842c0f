"""A swap between two processes, make before break: the table of its steps, and what they do.

Until the new process receives :class:`~palp_core.graph.process.swap_messages.Commit` it publishes nothing, so
that there is one owner at every instant, and every step can be undone.
"""

from pathlib import Path
from typing import Any

import msgspec

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest
from palp_core.graph.lockstep.simulated_time import SimulatedTime
from palp_core.graph.messages.message import decode_any
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.loading import endpoints
from palp_core.graph.node.spec import HUNG_S
from palp_core.graph.process.control_messages import Configured, Done, Matched, Raised
from palp_core.graph.process.swap_messages import (
    HANDLER,
    AnnouncePredecessorDead,
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
from palp_core.graph.supervision.process_probation import ProcessProbation
from palp_core.graph.supervision.standby import Standby
from palp_core.graph.supervision.supervisor import Supervisor
from palp_core.graph.swap.step_engine import FAREWELL_NS, LARGE_BYTES, NEW, OLD, Step, StepEngine
from palp_core.graph.swap.swap import CheckedSwap, SwapReport, why_not_swappable
from palp_core.graph.transport.offsets import ReceivedOffsets

LINGER_NS = 60_000_000_000
"""How long an old process stays for a reader that is stopped or slow (assumed)."""

ALWAYS, WITH_SHADOW, ON_PROBATION = "", "with a shadow", "on probation"
ON_WALL_PROBATION, IN_SIM_PROBATION = "on probation, wall clock", "on probation, simulated time"
"""When a step is part of a swap."""


class ProcessSwaps:
    """The swaps of a graph of processes.

    Args:
        supervisor: Has the processes.
        folder: The run directory.
        workspace: Folder that holds ``nodes/``.
        time: Simulated time.
    """

    def __init__(self, supervisor: Supervisor, folder: Path, workspace: Path, time: SimulatedTime) -> None:
        self._supervisor, self._folder, self._workspace = supervisor, folder, workspace
        self._time = time
        self._current: ProcessSwap | None = None

    @property
    def step(self) -> str:
        """The step of the swap that is under way; "" if there is none."""
        return self._current.step if self._current is not None else ""

    def inspect_class(self, request: NodeClassRequest, timeout_s: float) -> NodeClass:
        """Let a forked child import a class and describe what it declares."""
        standbys = self._supervisor.standbys
        standbys.inspect([request], self._workspace)
        deadline_ns = monotonic_ns() + round(timeout_s * 1e9)
        if not self._supervisor.wait_until(lambda: standbys.inspected is not None, deadline_ns):
            standbys.kill_inspector()
            error = f"it could not be imported within {timeout_s:g} s"
            return NodeClass(run=request.run, error=error)
        assert standbys.inspected is not None
        return standbys.inspected[0]

    def swap(self, swap: CheckedSwap, now_ns: int) -> tuple[SwapReport, Done | None]:
        """Let a new process take the place of a node's.

        Raises:
            SwapFailed: A step failed; the old node goes on.
        """
        self._current = ProcessSwap(self._supervisor, self._folder, swap, now_ns, self._time)
        try:
            return self._current.run()
        finally:
            self._current = None


class ProcessSwap(StepEngine):
    """One swap: what the steps of the table do.

    Args:
        supervisor: Has the processes.
        folder: The run directory.
        swap: What is replaced by what.
        now_ns: Time on the graph's clock.
        time: Simulated time.
    """

    def __init__(
        self, supervisor: Supervisor, folder: Path, swap: CheckedSwap, now_ns: int, time: SimulatedTime
    ) -> None:
        super().__init__(supervisor, folder, swap)
        self._now_ns, self._time = now_ns, time
        self._begun_ns = monotonic_ns()
        self._wall = bool(supervisor.start_ns)
        self._after: ReceivedOffsets = {}
        self._on_probation = self._can_roll_back = False
        self._probation_end_ns = 0
        self._report_request = RequestReport()
        self._latest = WorkReport(b"", [], 0, -1, HANDLER)
        self._unpublished: list[bytes] = []
        self._comparison: dict[str, Any] = {}

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
            while self._has(ON_WALL_PROBATION) and not self._latest.last:
                self._walk(PROBATION)
            self._walk(COMMIT)
        except BaseException:
            if not self._committed:
                self._roll_back()
            raise
        handover, taken = self._answer(Handover), self._answer(TookOver)
        done = Done(handover.frames + taken.frames, taken.next_due_ns, None)
        return self._report(self._answer(Working)), None if self._has(IN_SIM_PROBATION) else done

    def _walk(self, steps: tuple[Step, ...]) -> None:
        for step in steps:
            if self._has(step.when):
                self.take(step)

    def _has(self, when: str) -> bool:
        return {
            ALWAYS: True,
            WITH_SHADOW: self._request.shadow_s > 0.0,
            ON_PROBATION: self._on_probation,
            ON_WALL_PROBATION: self._on_probation and self._wall,
            IN_SIM_PROBATION: self._on_probation and not self._wall,
        }[when]

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
        for process in self._supervisor.processes:
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

    def start_process(self) -> None:
        spec = self._old.successor_spec(self._swap.new)
        self._standby = self._supervisor.standbys.start(spec, self._old.log, fresh=True)
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
        processes = self._supervisor.processes
        return sorted(
            process.spec.name for process in processes if process.active and process.spec.name in readers
        )

    def wait_for_readers(self, step: Step) -> None:
        """Wait until the graph's own readers listen at the new place; others can ask for what they miss."""
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
        return TakeOver(
            self._answer(Handover), self._request.params, self._supervisor.start_ns, shadow=publish
        )

    def let_both_work(self, step: Step) -> None:
        self.wait_for_answer(step)
        supervisor, new = self._supervisor, self._new
        duration_ns = round(self._request.shadow_s * 1e9)
        self._deadline_ns += duration_ns
        begun_ns = monotonic_ns()
        if self._wall:
            supervisor.wait_until(lambda: bool(new.failure) or self._old.ended, begun_ns + duration_ns)
            return
        running = decode_any(HandOver, self._answer(Handover).hand_over)
        comparison = self._swap.comparison(running.published)
        supervisor.shadow = (self._index, new, comparison)
        try:
            self._time.elapse(duration_ns)
        finally:
            supervisor.shadow = None
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
        self._old.handed_over = True
        if self._wall:
            self._now_ns = handover.at_ns - self._supervisor.start_ns

    def take_over(self) -> TakeOver:
        handover, start_ns = self._answer(Handover), self._supervisor.start_ns
        return TakeOver(handover, self._request.params, start_ns, self._on_probation)

    # Probation

    def begin_probation(self, step: Step) -> None:
        self.wait_for_answer(step)
        self._probation_end_ns = monotonic_ns() + round(self._swap.standby_s * 1e9)

    def request_report(self) -> RequestReport:
        """Ask for one report: the last, if the new node is proven or the old one can publish none.

        Where the old one could not go on from a report, the first that counts a handler is the last.
        """
        enough = self._latest.proof_count >= self._swap.probation.run_count
        is_proven = enough if self._can_roll_back else self._latest.run_count > 0
        if is_proven or self._must_end() or monotonic_ns() >= self._probation_end_ns:
            self._report_request = RequestReport(last=True)
        elif self._can_roll_back:
            self._report_request = RequestReport(self._probation_end_ns)
        else:
            self._report_request = RequestReport(self._probation_end_ns, handler_count=1, last=True)
        return self._report_request

    def _must_end(self) -> bool:
        return self._old.ended or self._supervisor.exit_code is not None

    def keep_report(self, step: Step) -> None:
        """Wait for the report; if the probation must end meanwhile, for the last one."""
        new = self._new
        if not self._wait_for_report(new):
            self._report_request = RequestReport(last=True)
            self._send(NEW, self._report_request)
            self._wait_for_report(new)
        replies = list(self._successor.replies)
        self._successor.replies.clear()
        for event in replies:
            if isinstance(event, Raised):
                self._supervisor.hear(self._index, event)
        self._check_successor()
        reports = [reply for reply in replies if isinstance(reply, WorkReport)]
        frames = [frame for report in reports for frame in report.frames]
        self._answers[step.awaits] = msgspec.structs.replace(reports[-1], frames=frames)

    def _wait_for_report(self, new: Standby) -> bool:
        """Return whether there is one, or a failure."""
        supervisor, request = self._supervisor, self._report_request

        def has_report() -> bool:
            reports = (reply for reply in self._successor.replies if isinstance(reply, WorkReport))
            return bool(new.failure) or any(report.last == request.last for report in reports)

        def is_over() -> bool:
            return has_report() or (request.until_ns > 0 and self._must_end())

        limit_s = HUNG_S["wall"]
        if self._state_bytes() > LARGE_BYTES:  # to write it down takes time, too
            limit_s = max(limit_s, self._request.timeout_s)
        hung_ns = max(request.until_ns, monotonic_ns()) + round(limit_s * 1e9)
        incoming_bytes = supervisor.standbys.incoming_bytes
        if not supervisor.wait_until(lambda: is_over() or incoming_bytes(new) > 0, hung_ns):
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
            return self._found(step) is not None or self._old.ended

        self._extend_deadline()
        if self._can_roll_back:
            self._wait_for(is_over, "the old node did not publish a report")
        else:
            self._supervisor.wait_until(is_over, self._deadline_ns)
        answer = self._found(step)
        if answer is None and self._old.ended:
            self._unpublished += self._latest.frames
        self._can_roll_back &= answer is not None and not answer.error
        self._must_commit = self._latest.last and not self._can_roll_back

    def prove_in_rounds(self, _: Step) -> None:
        """Let simulated time pass while the old node is on standby."""
        wanted, supervisor, former = self._swap.probation, self._supervisor, self._new
        inputs = self._swap.new.inputs.values()
        probation = ProcessProbation(
            supervisor, former, self._index, inputs, wanted.run_count, can_roll_back=self._can_roll_back
        )
        supervisor.probation = probation
        taken = self._answer(TookOver)
        done = Done(taken.frames, taken.next_due_ns, None)
        try:
            first = probation.begin(self._answer(Handover).frames, done)
            self._time.pass_probation(probation, first, wanted.longest_s, self._request.timeout_s)
        finally:
            supervisor.probation = None
        self._latest = WorkReport(b"", [], 0, probation.proof_count, probation.proof)
        if probation.failure:
            self._committed = False
            self._fail(probation.failure)

    # Commit and leave

    def commit(self) -> Commit:
        runs = {"before": self._swap.old.run, "after": self._swap.new.run}
        return Commit({"at_s": self._now_ns / 1e9, **runs}, self._unpublished)

    def promote(self, step: Step) -> None:
        """Give the new process the node's part; if it fails from now on, the node has failed."""
        supervisor, index, new = self._supervisor, self._index, self._new
        self._committed = True
        supervisor.promote(index, new)
        supervisor.wait_until(
            lambda: self._found(step) is not None or self._successor.ended, monotonic_ns() + FAREWELL_NS
        )
        self._answers[Working] = self._found(step) or Working(0.0, self._answer(TookOver).held)

    def send_away(self) -> Leave:
        return Leave(LINGER_NS)

    def redirect_tools(self, _: Step) -> None:
        """Let the node's name lead to the new process when the old one has ended.

        It stays as long as a reader has not had all that it published, but nothing waits for that.
        """
        supervisor, former = self._supervisor, self._new
        place = supervisor.processes[self._index].place
        former.on_end = lambda: self._redirect(former, place)
        has_died = former.process.ended  # before its end was watched
        if has_died or not supervisor.wait_until(lambda: former.process.ended, monotonic_ns() + FAREWELL_NS):
            former.on_end()

    def _redirect(self, former: Standby, place: str) -> None:
        folder, supervisor, index = self._folder, self._supervisor, self._index
        node, before = self._request.node, former.process.place
        if supervisor.processes[index].place != place:
            return  # it has changed hands again
        if self._wall and former.process.ended and not former.has_left:
            supervisor.send_if_connected(index, AnnouncePredecessorDead())
        for end in ("pub", "srv"):
            link = folder / f"+{node}.{end}.link"
            link.unlink(missing_ok=True)
            link.symlink_to(f"{place}.{end}")
            link.replace(folder / f"{node}.{end}")
            if before != node:
                (folder / f"{before}.{end}").unlink(missing_ok=True)


PREPARATION = (
    Step("start", ALWAYS, OLD, ProcessSwap.request_copy, Handover, ProcessSwap.judge_running),
    Step("configure", ALWAYS, NEW, ProcessSwap.start_process, Configured),
    Step("configure", ALWAYS, NEW, ProcessSwap.send_nothing, Matched),
    Step("connect", ALWAYS, OLD, ProcessSwap.announce_successor, SuccessorAnnounced, undo=CancelMove()),
    Step("connect", ALWAYS, NEW, ProcessSwap.await_readers, ReadersReady, ProcessSwap.wait_for_readers),
    Step("state", ALWAYS, OLD, ProcessSwap.request_copy_to_try, Handover),
    Step("state", ALWAYS, NEW, ProcessSwap.try_state, DryRunResult, ProcessSwap.keep_offsets),
    Step("state", ON_PROBATION, OLD, ProcessSwap.try_way_back, DryRunResult, ProcessSwap.judge_way_back),
    Step("shadow", WITH_SHADOW, OLD, ProcessSwap.request_copy, Handover),
    Step("shadow", WITH_SHADOW, NEW, ProcessSwap.begin_shadow, TookOver, ProcessSwap.let_both_work),
    Step("shadow", WITH_SHADOW, NEW, ProcessSwap.end_shadow, Shadowed, ProcessSwap.keep_comparison),
)
"""The steps in which the old node works; a dry run ends here."""

CHANGE = (
    Step("hand over", ALWAYS, OLD, ProcessSwap.request_last_copy, Handover, ProcessSwap.free_old, Resume()),
    Step("take over", ALWAYS, NEW, ProcessSwap.take_over, TookOver, ProcessSwap.begin_probation),
)
"""The steps in which neither works."""

PROBATION = (
    Step(
        "probation", ON_WALL_PROBATION, NEW, ProcessSwap.request_report, WorkReport, ProcessSwap.keep_report
    ),
    Step("probation", ON_WALL_PROBATION, OLD, ProcessSwap.pass_on, Published, ProcessSwap.judge_publication),
)
"""What is repeated until the new node is proven: one report at a time, so that nothing overtakes it."""

COMMIT = (
    Step("commit", ALWAYS, NEW, ProcessSwap.commit, Working, ProcessSwap.promote),
    Step(
        "probation", IN_SIM_PROBATION, NEW, ProcessSwap.send_nothing, WorkReport, ProcessSwap.prove_in_rounds
    ),
    Step("leave", ALWAYS, OLD, ProcessSwap.send_away, Done, ProcessSwap.redirect_tools),
)
"""The steps that are not undone, but for a probation in simulated time."""

TABLE = (*PREPARATION, *CHANGE, *PROBATION, *COMMIT)
