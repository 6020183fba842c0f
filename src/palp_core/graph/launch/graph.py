"""A graph from its launch file to its end; what ``palp launch`` does, for Python.

::

    with Graph("launch/sim.yaml", policy="markov") as graph:
        summary = graph.run()
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import msgspec

from palp_core.errors import GraphError, PalpError, in_words
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.run_directory import RunDirectory
from palp_core.graph.launch.checking import ask_report, check_in
from palp_core.graph.launch.checkpoint import RESUMES, Checkpoints
from palp_core.graph.launch.log_screen import Show, Shown, showing_log
from palp_core.graph.launch.observers import MessageObservers
from palp_core.graph.launch.run_journal import RunJournal
from palp_core.graph.launch.runs import LockstepRun, WallRun
from palp_core.graph.launch.summary import RunSummary, report_function, summary_of
from palp_core.graph.lockstep.conductor import Observer
from palp_core.graph.messages.builtin import (
    DiagnosticStatus,
    GraphEvent,
    GraphHealth,
    MethodsUsed,
    NodeEvent,
    NodeHealth,
    Swap,
)
from palp_core.graph.node.spec import MERGED_LOG
from palp_core.graph.recording.provenance import launch_provenance
from palp_core.graph.recording.recorders import Recorders
from palp_core.graph.supervision.class_inspection import ToRun
from palp_core.graph.supervision.fork_child import open_many_files
from palp_core.graph.supervision.fork_server import ForkServer
from palp_core.graph.supervision.fork_start import ServerProcess
from palp_core.graph.supervision.interrupt import Interrupt, Interrupted
from palp_core.graph.supervision.launcher_node import LauncherNode
from palp_core.graph.supervision.logs import LogLevels, levels_of
from palp_core.graph.supervision.run_record import run_record
from palp_core.graph.swap.swap import AskToSwap, SwapRequest
from palp_core.graph.workspaces.underlays import launch_path

if TYPE_CHECKING:
    from palp_core.graph.description.checked import CheckedGraph
    from palp_core.graph.network.gateway_handle import GatewayHandle
    from palp_core.graph.process.control_messages import Done
    from palp_core.graph.supervision.supervisor import Supervisor

POLL_INSTANTS = 32  # asking a socket costs as much as a message; tools wait a few ms more


class Graph:
    """A checked graph, started on entry and ended on exit.

    Args:
        path: The launch file; ``rig:sim.yaml`` is one of an installed workspace.
        compose: All nodes in this process (simulated time only).
        observe: Takes every frame in lockstep, and those of the launch on the wall clock.
        started: A fork server's process that was started before.
        overrides: Arguments as the command line has them, ``name:=value``.
        listen: ``tcp://HOST:PORT`` where other hosts may call; the launch file's ``listen`` by default.
        record: Record every topic into this bag, which must not exist.
        name: What the running graph is called; the launch file's ``graph`` by default.
        resume: Go on where an interrupted run was last written down (the launch file's ``checkpoint``).
        log_level: The least of what nodes log that is shown; what is shown they log.
        show_log: Shows a line of their logs; on a thread of its own.
        args: Arguments as Python values.

    Raises:
        GraphProblems: The launch file has problems.
        NodeError: A node failed.
        Interrupted: Ctrl-C, SIGTERM or a closed terminal.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        compose: bool = False,
        observe: Observer | None = None,
        overrides: Sequence[str] = (),
        started: ServerProcess | None = None,
        listen: str | None = None,
        record: str | Path | None = None,
        name: str | None = None,
        resume: bool = False,
        log_level: str | LogLevels = "warning",
        show_log: Show | None = None,
        **args: Any,
    ) -> None:
        self.path = Path(path)
        self._listen, self.record = listen, None if record is None else Path(record)
        self.recorders = Recorders()
        self.journal = RunJournal()
        self.observers = MessageObservers()
        self.observers.add(DiagnosticStatus, self.journal.observe_status)
        self.observers.add(MethodsUsed, self.journal.observe_methods)
        self.observers.add(GraphEvent, self.journal.observe_event)
        self.observers.add(NodeEvent, self.journal.observe_event)
        self.observers.add(GraphHealth, self._note_cpu)
        self.observers.add(Swap, self._plan_asked)
        self.gateway: GatewayHandle | None = None
        self._started, self._name, self._resume = started, name, resume
        self._compose = compose
        self._levels, self._show_log = levels_of(log_level), show_log
        self._is_observed, self._observe = observe is not None, observe or (lambda *_: None)
        self._overrides = [*overrides, *(f"{name}:={_scalar(value)}" for name, value in args.items())]
        self._stack = contextlib.ExitStack()
        self._interrupt = Interrupt()
        self._run: LockstepRun | WallRun | None = None
        self._supervisor: Supervisor | None = None
        self._instant_count, self._begun, self._begin_ns = 0, False, 0
        self._cpu_s: dict[str, float] = {}
        self.summary: RunSummary | None = None

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            stack.enter_context(self._interrupt)
            self.directory = RunDirectory(self._name or launch_path(self.path).stem, self._name)
            stack.callback(self.directory.release)
            self._interrupt.asked_by = self.directory.end_asked_by
            server = ForkServer(self._interrupt, self._started)
            stack.callback(server.close)
            try:
                self._check(stack, server)
                self.launcher_node = LauncherNode(
                    str(self.directory.path), self._now_ns, observe=self._keep_frame, joined=self._joined
                )
                stack.callback(self.launcher_node.close)
                self._prepare(stack, server)
            except (PalpError, Interrupted):  # nothing has run: there are no logs to keep
                server.close()
                self.directory.remove()
                raise
            stack.callback(self.recorders.close)
            stack.enter_context(self._showing_log())
            self.recorders.launcher_node = self.launcher_node
            self._answer_tools()
            self._run = self._start_composed(stack, server) if self._compose else self._start(stack, server)
            self._open_swaps(self._run)
            self._announce()
            if self._supervisor is not None:
                self._supervisor.prepare_recorders()
            self._stack = stack.pop_all()
        return self

    def __exit__(self, _: type[BaseException] | None, error: BaseException | None, *__: object) -> None:
        self._stack.close()
        if error is not None and self._begun and self.summary is None:
            self.summary = self._cut_short(error)

    @property
    def _to_run(self) -> ToRun:
        return "composed" if self._compose else "forked"

    def _check(self, stack: contextlib.ExitStack, server: ForkServer) -> None:
        """Check the launch file, and find what an interrupted run has left."""
        checked = check_in(server, self.path, self._overrides, to_run=self._to_run)
        if self._compose and checked.clock != "sim":
            raise GraphError(f"{self.path}: only a graph with 'clock: sim' can be composed into one process")
        if not self._compose:
            open_many_files()
        name = self._name or checked.graph
        self.checked = msgspec.structs.replace(checked, graph=name, composed=self._compose)
        self.checkpoints = Checkpoints(self.checked, self._overrides, resume=self._resume)
        stack.callback(self.checkpoints.close)

    def _prepare(self, stack: contextlib.ExitStack, server: ForkServer) -> None:
        """Do what may still refuse the run: the report's say, classes of a checkpoint, bags, other hosts."""
        ask_report(self.checked, "prepare", self._summary())
        inspect = partial(server.inspect_classes, to_run=self._to_run)
        self.checked = self.checkpoints.with_successors(inspect)
        resumed = self.checkpoints.resumed
        kept = None if resumed is None else resumed.attached
        kept = kept or ask_report(self.checked, "attach", self._summary()) or {}
        self.checked = msgspec.structs.replace(self.checked, attached=kept)
        self.recorders = Recorders(self.checked, self.record, resumed=resumed is not None)
        self.checked = msgspec.structs.replace(self.checked, nodes=self.recorders.nodes)
        self.observers.follow(self.checked)
        self._open_gateway(stack)

    def _answer_tools(self) -> None:
        node = self.launcher_node
        node.answer("launch", lambda: launch_provenance(self.checked))
        node.answer("summary", lambda: {"summary": msgspec.to_builtins(self._summary())})

    def _start_composed(self, stack: contextlib.ExitStack, server: ForkServer) -> LockstepRun:
        from palp_core.graph.lockstep.composition import composed

        server.close()
        least, capture = self._levels.least_logged, self._show_log is not None
        nodes = stack.enter_context(
            composed(
                self.checked,
                self.directory,
                least,
                capture=capture,
                keep_orders=self._is_observed or self.recorders.in_launcher,
            )
        )
        return LockstepRun(nodes, self.checked, self._show, self._between_instants)

    def _start(self, stack: contextlib.ExitStack, server: ForkServer) -> LockstepRun | WallRun:
        from palp_core.graph.supervision.supervisor import Listeners, Supervisor

        checked, folder = self.checked, self.directory.path
        listeners = Listeners(self._show, self._announce, self._serve, checkpoint=self._gather_checkpoint)
        supervisor = self._supervisor = Supervisor(
            checked.spawned,
            checked.clock,
            checked.workspace,
            folder,
            server,
            self._interrupt,
            self.launcher_node,
            listeners,
            self._levels,
        )
        stack.callback(supervisor.close)
        if self.gateway is not None:
            self.gateway.follow(supervisor)
        supervisor.start()
        if checked.clock == "sim":
            return LockstepRun(supervisor, checked, self._show, self._between_instants)
        return WallRun(supervisor, checked, self.gateway)

    def _open_swaps(self, run: LockstepRun | WallRun) -> None:
        from palp_core.graph.swap.swapper import Swapper

        folder, report = self.directory.path, self.launcher_node.report
        self.swaps = Swapper(self.checked, run.nodes, folder, self._now_ns, self._swapped, report)
        self.swaps.conductor = run.conductor
        self.launcher_node.answer("swap_progress", self.swaps.progress)
        self.launcher_node.defer("swap", AskToSwap, self.swaps.answer)

    def _open_gateway(self, stack: contextlib.ExitStack) -> None:
        if (address := self._listen or self.checked.listen) or self.checked.expected:
            from palp_core.graph.network.gateway_handle import GatewayHandle

            folder, report = self.directory.path, self.launcher_node.report
            self.gateway = GatewayHandle(address, self.checked, folder, report, self._announce)
            stack.callback(self.gateway.close, "the graph has failed", finished=False)

    def _showing_log(self) -> contextlib.AbstractContextManager[None]:
        if self._show_log is None:
            return contextlib.nullcontext()
        outputs = {spec.name: spec.output for spec in self.checked.nodes}
        shown = Shown(self._levels, outputs, self._show_log, self.directory.path.name)
        return showing_log(self.directory.log(MERGED_LOG), shown)

    def _announce(self) -> None:
        """Write where everything is, for those who look into the run directory and those who ask."""
        processes = self._supervisor.processes if self._supervisor is not None else ()
        pids = {process.spec.name: process.pid for process in processes}
        record = run_record(self.checked, self.path, self.directory, pids, composed=self._compose)
        self.launcher_node.record = record if self.gateway is None else self.gateway.described(record)
        self.directory.write(self.launcher_node.record)

    def run(self, until_s: float | None = None) -> RunSummary:
        """Activate, work until the run ends (or until a time on the graph's clock), and reach the safe state.

        Returns:
            How it went. The launch file's report has been written, unless there was a time to stop at.
        """
        assert self._run is not None
        self._begin_ns = monotonic_ns()
        if (begun := ask_report(self.checked, "begin", self._summary())) is not None:
            self._stack.callback(begun.close)
        self.checkpoints.begin()
        self._begun = True
        if (found := self.checkpoints.resumed) is not None and isinstance(self._run, WallRun):
            self.journal.restore(found.journal)
            self._run.resume({node.name: node.kept for node in found.nodes}, found.now_ns)
        count = len(self.checked.spawned)
        announcing = self.launcher_node.announcing(self.checked.graph, count, resumed=found is not None)
        exit_code = self._run.go(None if until_s is None else round(until_s * 1e9), announcing)
        ended = "" if exit_code == 0 else f"a node ended the run with exit code {exit_code}"
        self.summary = self._outcome(exit_code, ended)
        if exit_code == 0 and until_s is None:
            self.checkpoints.finish()
        if self.checked.report and until_s is None:
            self.summary = self._reported(self.summary)
        return self.summary

    def _gather_checkpoint(self, name: str, sequence: int, node: bytes) -> None:
        """Take a node that was written down; write a checkpoint once all are there."""
        if kept := self.checkpoints.gather(name, sequence, node):
            now_ns = self._now_ns()
            trouble = self.checkpoints.write(self.checked, kept, now_ns, self.journal.entries)
            if trouble is not None:
                self.journal.add_own(trouble, RESUMES, now_ns)

    def _summary(self, **outcome: Any) -> RunSummary:
        entries = self.journal.entries
        return summary_of(
            self.checked,
            self.path,
            run=self.directory.path.name,
            given=self._overrides,
            resumed_count=self.checkpoints.resumed_count,
            incidents=entries.incidents,
            methods=entries.methods,
            changes=entries.changes,
            cpu_s=self._cpu_s,
            **outcome,
        )

    def _outcome(self, exit_code: int, ended: str) -> RunSummary:
        assert self._run is not None
        wall_s = (monotonic_ns() - self._begin_ns) / 1e9
        return self._summary(
            exit_code=exit_code,
            ended=ended,
            clock_s=self._run.clock_s(wall_s),
            wall_s=wall_s,
            activation_count=self._run.activation_count,
        )

    def _cut_short(self, error: BaseException) -> RunSummary:
        """Return how a run went that an error or a signal has ended; every node has ended, too."""
        if isinstance(error, Interrupted):
            summary = self._outcome(128 + int(error.signal), str(error))
        else:
            summary = self._outcome(1, in_words(error))
        if not self.checked.report:
            return summary
        if not self._interrupt.second_request:
            with contextlib.suppress(KeyboardInterrupt):
                return self._reported(summary)
        text = "No report was written: the end was asked for twice; `palp session report` makes it later."
        return msgspec.structs.replace(summary, report=text)

    def _reported(self, summary: RunSummary) -> RunSummary:
        """Return the summary with what the launch file's report returns; if that fails, no exit code is 0."""
        exit_code = summary.exit_code
        try:
            text = report_function(self.checked.report, self.checked.workspace)(summary)
        except (Exception, SystemExit) as failure:  # noqa: BLE001 - a report may raise anything
            text, exit_code = f"No report was written: {in_words(failure)}", exit_code or 1
        return msgspec.structs.replace(summary, report=text, exit_code=exit_code)

    def _now_ns(self) -> int:
        """Return the time on the graph's clock; 0 before it starts."""
        return 0 if self._run is None else self._run.now_ns

    def _note_cpu(self, _: int, __: str, health: GraphHealth) -> None:
        self._cpu_s |= {node.node: node.cpu_s for node in health.nodes}

    def _plan_asked(self, now_ns: int, name: str, asked: Swap) -> None:
        self.swaps.plan_asked(now_ns, name, asked)

    def _joined(self) -> list[NodeHealth]:
        return [] if self.gateway is None else self.gateway.health

    def _show(self, now_ns: int, frame: bytes) -> None:
        self._observe(now_ns, frame)
        self._keep_frame(now_ns, frame)

    def _keep_frame(self, now_ns: int, frame: bytes) -> None:
        self.observers(now_ns, frame)
        self.recorders.observe(now_ns, frame)

    def plan_swap(self, at_s: float, node: str, run: str, **params: Any) -> None:
        """Let another class take a node's place when it is that time on the graph's clock.

        A swap that fails then ends the run: it would not be what it was planned to be.
        """
        self.swaps.plan(round(at_s * 1e9), SwapRequest(node=node, run=run, params=params))

    def _swapped(self, checked: CheckedGraph, index: int, done: Done | None) -> None:
        assert self._run is not None
        self.checked = checked
        self.observers.follow(checked)
        self.recorders.follow(checked)
        self._announce()
        self._run.replace(checked, index, done)

    def _serve(self) -> None:
        """Do what tools have asked for and what is planned; look for nodes of other hosts that are silent."""
        if self.gateway is not None:
            self.gateway.report_silence()
        self.launcher_node.run_deferred()
        self.swaps.run_due()

    def _between_instants(self) -> None:
        """Between two instants: is the end wanted, does a tool ask?"""
        self._interrupt.check()
        self._serve()
        self._instant_count += 1
        if self._compose and self._instant_count % POLL_INSTANTS == 0:
            self.launcher_node.poll()  # the supervisor does it where there is one


def _scalar(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
