"""A swap between two processes, make before break: each step can fail, and then the old one goes on.

Until the new process is told :class:`Go` it publishes nothing, so that there is one owner at every instant.
"""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import msgspec

from palp_core.errors import GraphError, NodeError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest
from palp_core.graph.lockstep.simulated_time import SimulatedTime
from palp_core.graph.messages.message import decode_any
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.loading import endpoints
from palp_core.graph.node.spec import HUNG_S
from palp_core.graph.process import swap_messages
from palp_core.graph.process.control_messages import Done, Raised
from palp_core.graph.supervision.process_probation import ProcessProbation
from palp_core.graph.supervision.standby import Standby
from palp_core.graph.supervision.supervisor import Supervisor
from palp_core.graph.swap.swap import CheckedSwap, SwapFailed, SwapReport, unfit
from palp_core.graph.transport.offsets import ReceivedOffsets

Answer = TypeVar("Answer", bound=swap_messages.FromSwapped)

FAREWELL_NS = 1_000_000_000
LINGER_NS = 60_000_000_000
"""How long an old process stays for a reader that is stopped or slow (assumed)."""


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
        self._under_way: _ProcessSwap | None = None

    @property
    def step(self) -> str:
        """The step that the swap which is under way has come to; "" if there is none."""
        return self._under_way.step if self._under_way is not None else ""

    def inspect_class(self, request: NodeClassRequest, timeout_s: float) -> NodeClass:
        """Let a forked child import a class and say what it declares."""
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
        self._under_way = _ProcessSwap(self._supervisor, self._folder, swap, now_ns, self._time)
        try:
            return self._under_way.run()
        finally:
            self._under_way = None


class _ProcessSwap:
    """One swap, step by step.

    Args:
        supervisor: Has the processes.
        folder: The run directory.
        swap: What is replaced by what.
        now_ns: Time on the graph's clock.
        time: Simulated time.

    Attributes:
        step: Which it has come to.
    """

    def __init__(
        self,
        supervisor: Supervisor,
        folder: Path,
        swap: CheckedSwap,
        now_ns: int,
        time: SimulatedTime,
    ) -> None:
        self._time = time
        self._supervisor, self._folder, self._swap = supervisor, folder, swap
        self._index, self._now_ns = swap.index, now_ns
        self._old = supervisor.processes[swap.index]
        self._begun_ns = monotonic_ns()
        self._deadline_ns = self._begun_ns + round(swap.request.timeout_s * 1e9)
        self.step = "start"
        self._new: Standby | None = None
        self._announced = self._paused = self._changed = False
        self._on_probation = self._way_back = False
        self._proven, self._ran, self._proof = -1, 0, swap_messages.HANDLER
        self._comparison: dict[str, Any] = {}
        self._state_bytes = 0

    def run(self) -> tuple[SwapReport, Done | None]:
        if why := self._impediment():
            self._fail(why)
        try:
            after = self._prepare()
            if self._swap.request.shadow_s:
                after = self._shadow(after)
            if self._swap.request.dry_run:
                self._roll_back()
                return self._report(None, 0), None
            return self._change(after)
        except BaseException:
            if not self._changed:
                self._roll_back()
            raise

    # Steps

    def _impediment(self) -> str:
        """Return who of those that a swap needs is not there just now; "" if all are."""
        if absence := self._old.absence():
            return f"the node itself {absence}"
        supervisor, checked, node = self._supervisor, self._swap.checked, self._swap.request.node
        if not supervisor.start_ns:
            return ""  # in simulated time nobody listens to sockets
        readers = {
            end for name, ends in checked.edges.items() if name.split("/")[1] == node for end, _ in ends
        }
        publishers = {name.split("/")[1] for name in self._swap.new.inputs.values()}
        for process in supervisor.processes:
            name = process.spec.name
            absence = process.absence() if name in readers | publishers else ""
            if absence:
                what = "which reads it" if name in readers else "which it reads"
                return f"/{name}, {what}, {absence}"
        return ""

    def _prepare(self) -> ReceivedOffsets:
        """Bring a new process as far as it comes while the old one works."""
        running = decode_any(HandOver, self._request_hand_over({}, pause=False).hand_over)
        if why := unfit(running, self._swap):
            self._fail(why)
        self._on_probation = self._swap.probation.run_count > 0 and running.active
        self.step = "configure"
        supervisor = self._supervisor
        new_spec = self._old.successor_spec(self._swap.new)
        self._new = supervisor.standbys.start(new_spec, self._old.log, fresh=True)
        new = self._new.process
        self._wait_for(lambda: new.configured, "it was not configured")
        self._wait_for(lambda: new.matched, "it did not hear all of its publishers")
        self.step = "connect"
        self._announced = True
        publish, serve = endpoints(str(self._folder), new.place)
        supervisor.listening.clear()
        self._send_old(swap_messages.Place(publish, serve))
        readers = self._reply_of_old(swap_messages.Announced).readers
        nodes = self._wait_for_readers(publish) if supervisor.start_ns else []
        self._send_new(swap_messages.Meet(readers, nodes))
        # Who does not come is no node of this graph, and can ask for what it missed.
        self._reply_of_new(swap_messages.Met)
        self.step = "state"
        handed = self._request_hand_over({}, pause=False, with_latest=self._swap.try_out)
        self._send_new(
            swap_messages.Rehearse(handed.hand_over, self._swap.request.params, self._on_probation)
        )
        rehearsed = self._reply_of_new(swap_messages.Rehearsed)
        if rehearsed.error:
            self._fail(rehearsed.error)
        if self._on_probation:
            self._send_old(swap_messages.Rehearse(rehearsed.tried, {}))
            self._way_back = not self._reply_of_old(swap_messages.Rehearsed).error
        return rehearsed.after

    def _wait_for_readers(self, publish: str) -> list[str]:
        """Wait until the graph's own readers listen at the new place; return them.

        Others can ask for what they miss.
        """
        supervisor, checked = self._supervisor, self._swap.checked
        wanted = {
            (supervisor.names.index(reader), name, publish)
            for name, ends in checked.edges.items()
            if name.split("/")[1] == self._swap.request.node
            for reader, _ in ends
            if reader in supervisor.names and supervisor.processes[supervisor.names.index(reader)].active
        }
        nodes = sorted({supervisor.names[index] for index, _, _ in wanted})
        deaf = ", ".join(f"/{name}" for name in nodes)
        text = f"not every reader listened at the new place; one is stopped or busy: {deaf}"
        self._wait_for(lambda: wanted <= supervisor.listening, text)
        return nodes

    def _shadow(self, after: ReceivedOffsets) -> ReceivedOffsets:
        """Let both work for a while, and only the old one be heard; return up to where the new one heard."""
        self.step = "shadow"
        request, supervisor, new = self._swap.request, self._supervisor, self._new
        assert new is not None
        handed = self._request_hand_over(after, pause=False)
        start_ns = supervisor.start_ns
        publish = endpoints(str(self._folder), self._old.place)[0] if start_ns else ""
        self._send_new(
            swap_messages.Shadow(handed.hand_over, request.params, start_ns, handed.heard, publish)
        )
        taken = self._reply_of_new(swap_messages.TookOver)
        if taken.error:
            self._fail(taken.error)
        duration_ns = round(request.shadow_s * 1e9)
        self._deadline_ns += duration_ns
        if start_ns:
            end_ns = monotonic_ns() + duration_ns
            supervisor.wait_until(lambda: bool(new.failure) or self._old.ended, end_ns)
        else:
            comparison = self._swap.comparison(decode_any(HandOver, handed.hand_over).published)
            begun_ns = monotonic_ns()
            supervisor.shadow = (self._index, new, comparison)
            try:
                self._time.elapse(duration_ns)
            finally:
                supervisor.shadow = None
            self._deadline_ns += monotonic_ns() - begun_ns
            self._now_ns += duration_ns
            self._comparison = comparison.report()
        self._send_new(swap_messages.EndShadow())
        shadowed = self._reply_of_new(swap_messages.Shadowed)
        if shadowed.report:
            self._comparison = msgspec.json.decode(shadowed.report)
        return shadowed.after

    def _change(self, after: ReceivedOffsets) -> tuple[SwapReport, Done | None]:
        request = self._swap.request
        self.step = "hand over"
        self._paused = True
        handed = self._request_hand_over(after, pause=True)
        self._old.handed_over = True
        self.step = "take over"
        start_ns = self._supervisor.start_ns
        self._send_new(
            swap_messages.TakeOver(
                handed.hand_over,
                request.params,
                start_ns,
                handed.heard,
                handed.remembered,
                handed.at_ns,
                self._on_probation,
            )
        )
        taken = self._reply_of_new(swap_messages.TookOver)
        if taken.error:
            self._fail(taken.error)
        assert self._new is not None
        if self._on_probation and start_ns:
            self.step = "probation"
        if self._new.process.has_died():  # with these words; how, the fork server is about to tell
            self._wait_for(lambda: False, "its process has died")
        if start_ns:
            self._now_ns = handed.at_ns - start_ns
        if self._on_probation and start_ns:
            self._prove()
        runs = {"before": self._swap.old.run, "after": self._swap.new.run}
        record = {"at_s": self._now_ns / 1e9, **runs}
        new, self._new = self._new, None
        self._changed = True  # from here on there is no way back but that of a probation in lockstep
        self._supervisor.standbys.send(new, swap_messages.Go(record))
        self._supervisor.promote(self._index, new)
        working = self._working()
        done: Done | None = Done([*handed.frames, *taken.frames], taken.next_due_ns, None)
        if self._on_probation and not start_ns:
            self._prove_in_lockstep(new, handed, taken)
            done = None
        self._end_former(new)
        held = taken.held if working is None else int(str(working.record["held"]))
        return self._report(working, held), done

    def _prove(self) -> None:
        """Let the new node work, and the old one publish what it reports, until enough handlers ran well.

        One report is under way at a time, and the last is published before the new node may publish: what
        comes later never overtakes it. Where the old one could not take the new one's state, it publishes
        nothing before one handler has run.
        """
        end_ns = monotonic_ns() + round(self._swap.standby_s * 1e9)
        reports: list[swap_messages.Commit] = []
        last = False
        while not last:
            last = self._probation_is_over() or monotonic_ns() >= end_ns
            for report in self._reports(end_ns, last=last):
                reports.append(report)
                self._proven, self._proof, self._ran = report.proof_count, report.proof, report.run_count
                if self._way_back or report.last:
                    for waiting in reports:
                        self._publish(waiting)
                    reports.clear()

    def _probation_is_over(self) -> bool:
        enough = self._proven >= self._swap.probation.run_count if self._way_back else self._ran > 0
        return enough or self._old.ended or self._supervisor.exit_code is not None

    def _reports(self, end_ns: int, *, last: bool) -> list[swap_messages.Commit]:
        """Ask the new node for one report, which comes when the probation ends if not before; return all."""
        supervisor, new = self._supervisor, self._new
        assert new is not None

        def arrived() -> bool:
            reports = (reply for reply in new.replies if isinstance(reply, swap_messages.Commit))
            is_over = not last and self._probation_is_over()
            return bool(new.failure) or is_over or any(report.last == last for report in reports)

        supervisor.standbys.send(new, swap_messages.CommitNow(end_ns, last))
        hung_ns = (monotonic_ns() if last else end_ns) + round(HUNG_S["wall"] * 1e9)
        if not supervisor.wait_until(lambda: arrived() or self._incoming_bytes() > 0, hung_ns):
            self._fail(f"a handler of it did not return within {HUNG_S['wall']:g} s")
        size = self._incoming_bytes()
        if not supervisor.wait_until(arrived, monotonic_ns() + round(self._swap.request.timeout_s * 1e9)):
            self._fail(f"the new node did not report its state of {size / 1e6:.0f} MB in time")
        replies, new.replies = new.replies, []
        for event in replies:
            if isinstance(event, Raised):
                supervisor.hear(self._index, event)
        if new.failure or (last and new.process.has_died()):
            self._fail(new.failure or "its process has died")
        return [reply for reply in replies if isinstance(reply, swap_messages.Commit)]

    def _incoming_bytes(self) -> int:
        assert self._new is not None
        return self._supervisor.standbys.incoming_bytes(self._new)

    def _publish(self, report: swap_messages.Commit) -> None:
        """Let the old node publish a report; one that is gone leaves that to the new one's history."""
        supervisor, replies = self._supervisor, self._supervisor.swap_replies
        timeout_s = self._swap.request.timeout_s
        self._send_old(report)
        supervisor.wait_until(
            lambda: isinstance(replies.get(self._index), swap_messages.Published) or self._old.ended,
            monotonic_ns() + round(timeout_s * 1e9),
        )
        answer = replies.pop(self._index, None)
        if isinstance(answer, swap_messages.Published):
            self._way_back = self._way_back and not answer.error
        elif self._way_back and not self._old.ended:
            size = len(report.hand_over)
            self._fail(f"the old node did not take a state of {size / 1e6:.0f} MB within {timeout_s:g} s")

    def _prove_in_lockstep(
        self, former: Standby, handed: swap_messages.HandedIn, taken: swap_messages.TookOver
    ) -> None:
        """Let simulated time go by while the old node stands by."""
        self.step = "probation"
        wanted, supervisor = self._swap.probation, self._supervisor
        inputs = self._swap.new.inputs.values()
        probation = ProcessProbation(
            supervisor, former, self._index, inputs, wanted.run_count, way_back=self._way_back
        )
        supervisor.probation = probation
        try:
            first = probation.begin(handed.frames, Done(taken.frames, taken.next_due_ns, None))
            self._time.pass_probation(probation, first, wanted.longest_s, self._swap.request.timeout_s)
        finally:
            supervisor.probation = None
        self._proven, self._proof = probation.proof_count, probation.proof
        if probation.failure:
            self._new, self._changed = former, False
            self._fail(probation.failure)

    def _report(self, working: swap_messages.Working | None, held: int) -> SwapReport:
        lockstep = not self._supervisor.start_ns
        gap_s = 0.0 if working is None else float(str(working.record["gap_s"]))
        return self._swap.report(
            at_ns=self._now_ns,
            gap_s=gap_s,
            held=held,
            duration_s=0.0 if lockstep else (monotonic_ns() - self._begun_ns) / 1e9,
            shadow=self._comparison,
            proven=self._proven,
            proven_by=self._proof,
        )

    def _working(self) -> swap_messages.Working | None:
        """Wait until the new node is at work; if it fails now, that is a failure of the node as any other."""
        supervisor, index = self._supervisor, self._index
        process = supervisor.processes[index]

        def answered() -> bool:
            return isinstance(supervisor.swap_replies.get(index), swap_messages.Working) or process.ended

        supervisor.wait_until(answered, monotonic_ns() + FAREWELL_NS)
        answer = supervisor.swap_replies.pop(index, None)
        return answer if isinstance(answer, swap_messages.Working) else None

    def _end_former(self, former: Standby) -> None:
        """Let the old process end; whoever looks for the node by its name is led to the new one.

        It stays as long as a reader has not had all that it published, but nobody waits for that.
        """
        supervisor = self._supervisor
        supervisor.standbys.send(former, swap_messages.Leave(LINGER_NS))
        former.on_end = self._redirecting(former, supervisor.processes[self._index].place)
        has_died = former.process.ended  # before anybody listened to its end
        if has_died or not supervisor.wait_until(lambda: former.process.ended, monotonic_ns() + FAREWELL_NS):
            former.on_end()

    def _redirecting(self, former: Standby, place: str) -> Callable[[], None]:
        folder, supervisor, index = self._folder, self._supervisor, self._index
        node, before = self._swap.request.node, former.process.place

        def redirect() -> None:
            if supervisor.processes[index].place != place:
                return  # it has changed hands again
            if supervisor.start_ns and former.process.ended and not former.has_left:
                supervisor.send_if_connected(index, swap_messages.Bury())
            for end in ("pub", "srv"):
                link = folder / f"+{node}.{end}.link"
                link.unlink(missing_ok=True)
                link.symlink_to(f"{place}.{end}")
                link.replace(folder / f"{node}.{end}")
                if before != node:
                    (folder / f"{before}.{end}").unlink(missing_ok=True)

        return redirect

    def _roll_back(self) -> None:
        """Leave all as it was; a new process has said nothing to anybody yet."""
        supervisor = self._supervisor
        if self._new is not None:
            supervisor.standbys.kill(self._new)
        if self._paused:
            self._send_old(swap_messages.Resume())
        if self._announced:
            self._send_old(swap_messages.Stay())
        new = self._new
        if new is not None:
            with contextlib.suppress(NodeError, GraphError):  # the swap's own failure is the news
                supervisor.wait_until(lambda: new.process.ended, monotonic_ns() + FAREWELL_NS)
            for end in ("pub", "srv"):
                (self._folder / f"{new.process.place}.{end}").unlink(missing_ok=True)
        if self._old.handed_over:
            self._old.handed_over = False
            if self._old.ended:
                supervisor.recover(self._index, "its process ended while its successor failed")

    # What is said to both processes, and how they answer

    def _fail(self, text: str) -> NoReturn:
        raise SwapFailed(self._swap.request.node, self.step, text)

    def _request_hand_over(
        self, after: dict[str, tuple[int, int]], *, pause: bool, with_latest: bool = False
    ) -> swap_messages.HandedIn:
        self._send_old(swap_messages.HandIn(after, pause, with_latest))
        handed = self._reply_of_old(swap_messages.HandedIn)
        self._state_bytes = len(handed.hand_over)
        return handed

    def _send_old(self, message: swap_messages.ToSwapped) -> None:
        self._supervisor.swap_replies.pop(self._index, None)
        self._supervisor.send_if_connected(self._index, message)

    def _send_new(self, message: swap_messages.ToSwapped) -> None:
        assert self._new is not None
        self._new.replies.clear()
        self._supervisor.standbys.send(self._new, message)

    def _reply_of_old(self, kind: type[Answer]) -> Answer:
        """Wait for an answer of this kind; another is late, of a swap before that waited for it no longer."""
        replies, index = self._supervisor.swap_replies, self._index
        missing = f"the old node did not answer ({kind.__name__})"
        self._wait_for(lambda: isinstance(replies.get(index), kind), missing)
        answer = replies.pop(index)
        assert isinstance(answer, kind)
        return answer

    def _reply_of_new(self, kind: type[Answer]) -> Answer:
        new = self._new
        assert new is not None

        def fitting() -> list[Answer]:
            return [reply for reply in new.replies if isinstance(reply, kind)]

        self._wait_for(lambda: bool(fitting()), f"the new node did not answer ({kind.__name__})")
        return fitting()[0]

    def _wait_for(self, condition: Callable[[], bool], failure: str) -> None:
        """Wait for something.

        Raises:
            SwapFailed: One of the processes has ended, or the time is over.
        """
        old, new = self._old, self._new

        def over() -> bool:
            gone = (old.ended and not old.handed_over) or old.respawn_at_ns is not None
            return condition() or gone or (new is not None and bool(new.failure))

        in_time = self._supervisor.wait_until(over, self._deadline_ns)
        if new is not None and new.failure:  # it may have answered before it died
            if self.step == "take over" and self._on_probation and condition():
                self.step = "probation"
            self._fail(new.failure)
        if condition():
            return
        if not in_time:
            size = f", with a state of {self._state_bytes / 1e6:.0f} MB" if self._state_bytes > 1e6 else ""
            self._fail(f"{failure} within {self._swap.request.timeout_s:g} s{size}")
        self._fail("the old node has ended")
