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
from typing import TYPE_CHECKING, Any, Literal, Self

import msgspec

from palp_core.errors import GraphError, PalpError, in_words
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.check import load
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.discovery.choice import check_free
from palp_core.graph.discovery.run_directory import RunDirectory
from palp_core.graph.launch.changes_told import ChangesTold
from palp_core.graph.launch.checkpoints import RESUMES, Checkpoints
from palp_core.graph.launch.diagnostics import Diagnostics
from palp_core.graph.launch.log_screen import Show, Shown, showing_log
from palp_core.graph.launch.methods_told import MethodsTold
from palp_core.graph.launch.observers import MessageObservers
from palp_core.graph.launch.summary import RunSummary, report_function, summary_of
from palp_core.graph.launch.wall_checkpoints import WallCheckpoints
from palp_core.graph.lockstep.conductor import Conductor, Observer
from palp_core.graph.messages.builtin import DiagnosticStatus, GraphEvent, MethodsUsed, NodeEvent
from palp_core.graph.node.spec import MERGED_LOG, NodeSpec
from palp_core.graph.process.control_messages import Done
from palp_core.graph.recording.provenance import launch_provenance
from palp_core.graph.recording.recorders import Recorders
from palp_core.graph.supervision.class_inspection import ToRun
from palp_core.graph.supervision.fork_server import ForkServer
from palp_core.graph.supervision.fork_start import ServerProcess
from palp_core.graph.supervision.interrupt import Interrupt, Interrupted, ended_after
from palp_core.graph.supervision.launcher_node import LauncherNode
from palp_core.graph.supervision.logs import LogLevels, levels_of
from palp_core.graph.supervision.run_record import run_record
from palp_core.graph.swap.compatibility import incompatibilities, replaced
from palp_core.graph.swap.swap import AskToSwap, SwapRequest
from palp_core.graph.workspaces.underlays import launch_path

if TYPE_CHECKING:
    from palp_core.graph.description.node_class import NodeClass
    from palp_core.graph.network.gateway_handle import GatewayHandle
    from palp_core.graph.supervision.supervisor import Supervisor
    from palp_core.graph.swap.step_engine import SwapHost

POLL_INSTANTS = 32  # asking a socket costs as much as a message; tools wait a few ms more


def _checked(path: Path, overrides: Sequence[str], server: ForkServer, *, to_run: ToRun) -> CheckedGraph:
    inspect = partial(server.inspect_classes, to_run=to_run)
    return load(path, overrides, inspect, succeed)


def succeed(checked: CheckedGraph, spec: NodeSpec, new_class: NodeClass) -> tuple[list[str], CheckedGraph]:
    """Return what speaks against a class in a node's place, and the graph with it there if nothing does."""
    wrong = incompatibilities(checked, spec, new_class)
    return wrong, checked if wrong else replaced(checked, spec, new_class, {})


def check_file(path: str | Path, overrides: Sequence[str] = ()) -> CheckedGraph:
    """Check a launch file as a whole without starting anything.

    Raises:
        GraphProblems: Every problem of the file, each with its place.
    """
    server = ForkServer()
    try:
        return _checked(Path(path), overrides, server, to_run="nowhere")
    finally:
        server.close()


def check_start(
    path: str | Path, checked: CheckedGraph, name: str | None = None, *, resume: bool = False
) -> list[str]:
    """Check what only a start would tell: that the name is free, and that the report has where to go.

    Returns what the launch file's report has to say of such a run beforehand, in words.

    Args:
        path: The launch file.
        checked: It, checked.
        name: What the running graph is to be called, if not as the launch file says.
        resume: It is to go on with an interrupted run.

    Raises:
        PalpError: It would not start.
    """
    if name is not None:
        check_free(name)
    with contextlib.closing(Checkpoints(checked, (), resume=resume)) as checkpoints:
        summary = summary_of(checked, Path(path), resumed_count=checkpoints.resumed_count)
    _tell(checked, "prepare", summary)
    return list(_tell(checked, "advise", summary) or ())


def _tell(
    checked: CheckedGraph, stage: Literal["prepare", "advise", "attach", "begin"], summary: RunSummary
) -> Any:
    """Let the launch file's report look at the run before it begins, if it wants to; return what it says."""
    if not checked.report:
        return None
    tell = getattr(report_function(checked.report, checked.workspace), stage, None)
    return None if tell is None else tell(summary)


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
        self._told = Diagnostics(), MethodsTold(), ChangesTold()
        self.diagnostics, self.methods, self.changes = self._told
        self.observers = MessageObservers()
        self.observers.add(DiagnosticStatus, self.diagnostics.observe)
        self.observers.add(MethodsUsed, self.methods.observe)
        self.observers.add(GraphEvent, self.changes.observe)
        self.observers.add(NodeEvent, self.changes.observe)
        self.gateway: GatewayHandle | None = None
        self._started, self._name, self._resume = started, name, resume
        self._compose = compose
        self._levels, self._show_log = levels_of(log_level), show_log
        self._observe = observe or (lambda *_: None)
        self._overrides = [*overrides, *(f"{name}:={_scalar(value)}" for name, value in args.items())]
        self._stack = contextlib.ExitStack()
        self._interrupt = Interrupt()
        self._conductor: Conductor | None = None
        self._supervisor: Supervisor | None = None
        self._instant_count, self._begun = 0, False
        self._begin_ns = self._gone_ns = 0
        self._cpu_s: dict[str, float] = {}
        self.summary: RunSummary | None = None

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            stack.enter_context(self._interrupt)
            if self._name is not None:
                check_free(self._name)
            self.directory = RunDirectory(self._name or launch_path(self.path).stem)
            stack.callback(self.directory.release)
            self._interrupt.asked_by = self.directory.end_asked_by
            server = ForkServer(self._interrupt, self._started)
            stack.callback(server.close)
            try:
                to_run: ToRun = "composed" if self._compose else "forked"
                self.checked = _checked(self.path, self._overrides, server, to_run=to_run)
                if self._name is not None:
                    self.checked = msgspec.structs.replace(self.checked, graph=self._name)
                if self._compose and self.checked.clock != "sim":
                    raise GraphError(
                        f"{self.path}: only a graph with 'clock: sim' can be composed into one process"
                    )
                if not self._compose:
                    server.make_room(len(self.checked.spawned))
                self.checked = msgspec.structs.replace(self.checked, composed=self._compose)
                self.checkpoints = Checkpoints(self.checked, self._overrides, resume=self._resume)
                stack.callback(self.checkpoints.close)
                _tell(self.checked, "prepare", self._summary())
                self.checked = self.checkpoints.with_successors(
                    partial(server.inspect_classes, to_run=to_run)
                )
                kept = self.checkpoints.attached or _tell(self.checked, "attach", self._summary()) or {}
                self.checked = msgspec.structs.replace(self.checked, attached=kept)
                self.recorders = self.checkpoints.recorders(self.checked, self.record)
                self.observers.follow(self.checked)
                self.checkpoints.on_trouble = lambda words: self.diagnostics.tell(
                    words, RESUMES, self._now_ns()
                )
                self._open_gateway(stack)
            except (PalpError, Interrupted):  # nothing has run: there are no logs to keep
                server.close()
                self.directory.remove()
                raise
            stack.callback(self.recorders.close)
            stack.enter_context(self._showing_log())
            self.launcher_node = LauncherNode(str(self.directory.path), self._now_ns)
            stack.callback(self.launcher_node.close)
            if (gateway := self.gateway) is not None:
                self.launcher_node.joined = lambda: gateway.health
            self.launcher_node.record_event = lambda frame: self._keep_frame(self._now_ns(), frame)
            self.launcher_node.on_health = lambda nodes: self._cpu_s.update((n.node, n.cpu_s) for n in nodes)
            self.launcher_node.answer("stop", lambda _: self._interrupt.asked(self.checked.graph))
            self.launcher_node.answer("launch", lambda _: launch_provenance(self.checked))
            self.launcher_node.answer("summary", lambda _: {"summary": msgspec.to_builtins(self._summary())})
            if self._compose:
                from palp_core.graph.lockstep.composition import composed

                server.close()
                self._nodes: SwapHost = stack.enter_context(
                    composed(
                        self.checked,
                        self.directory,
                        self._levels.least_logged,
                        capture=self._show_log is not None,
                    )
                )
            else:
                self._nodes = self._supervisor = self._supervised(stack, server)
                self._supervisor.on_new_process, self._supervisor.on_turn = self._announce, self._serve
            from palp_core.graph.swap.swapper import Swapper

            self.swaps = Swapper(
                self.checked,
                self._nodes,
                self.directory.path,
                self._now_ns,
                self._swapped,
                self.launcher_node.report,
            )
            self.launcher_node.answer("swap_progress", lambda _: self.swaps.progress())
            self.launcher_node.defer("swap", AskToSwap, self.swaps.answer)
            self._announce()
            self.recorders.start(self.directory.path, self.launcher_node, self._supervisor)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, _: type[BaseException] | None, error: BaseException | None, *__: object) -> None:
        self._stack.close()
        if error is not None and self._begun and self.summary is None:
            self.summary = self._cut_short(error)

    def _showing_log(self) -> contextlib.AbstractContextManager[None]:
        if self._show_log is None:
            return contextlib.nullcontext()
        outputs = {spec.name: spec.output for spec in self.checked.nodes}
        shown = Shown(self._levels, outputs, self._show_log, self.directory.path.name)
        return showing_log(self.directory.log(MERGED_LOG), shown)

    def _summary(self, **outcome: Any) -> RunSummary:
        return summary_of(
            self.checked,
            self.path,
            run=self.directory.path.name,
            given=self._overrides,
            resumed_count=self.checkpoints.resumed_count,
            incidents=self.diagnostics.incidents,
            methods=self.methods.told,
            changes=self.changes.told,
            cpu_s=self._cpu_s,
            **outcome,
        )

    def _cut_short(self, error: BaseException) -> RunSummary:
        """Return how a run went that an error or a signal has ended; every node has ended, too."""
        wall_s = (monotonic_ns() - self._begin_ns) / 1e9
        code = 128 + int(error.signal) if isinstance(error, Interrupted) else 1
        ended = str(error) if isinstance(error, Interrupted) else in_words(error)
        summary = self._summary(
            exit_code=code,
            ended=ended,
            clock_s=self._conductor.now_ns / 1e9
            if self._conductor is not None
            else wall_s + self._gone_ns / 1e9,
            wall_s=wall_s,
            activation_count=self._conductor.activation_count if self._conductor is not None else 0,
        )
        if not self.checked.report:
            return summary
        if not self._interrupt.second_request:
            with contextlib.suppress(KeyboardInterrupt):
                return self._reported(summary)
        said = "No report was written: the end was asked for twice; `palp session report` makes it later."
        return msgspec.structs.replace(summary, report=said)

    def _reported(self, summary: RunSummary) -> RunSummary:
        """Return the summary with what the launch file's report says; if that fails, no exit code is 0."""
        exit_code = summary.exit_code
        try:
            said = report_function(self.checked.report, self.checked.workspace)(summary)
        except (Exception, SystemExit) as failure:  # noqa: BLE001 - a report may raise anything
            said, exit_code = f"No report was written: {in_words(failure)}", exit_code or 1
        return msgspec.structs.replace(summary, report=said, exit_code=exit_code)

    def _now_ns(self) -> int:
        """Return the time on the graph's clock; 0 before it starts."""
        if self._conductor is not None:
            return self._conductor.now_ns
        start_ns = self._supervisor.start_ns if self._supervisor is not None else 0
        return monotonic_ns() - start_ns if start_ns else 0

    def _supervised(self, stack: contextlib.ExitStack, server: ForkServer) -> Supervisor:
        from palp_core.graph.supervision.supervisor import Supervisor

        supervisor = Supervisor(
            self.checked.spawned,
            self.checked.clock,
            self.checked.workspace,
            self.directory.path,
            server,
            self._interrupt,
            self._show,
            self.launcher_node,
            self._levels,
        )
        stack.callback(supervisor.close)
        if self.gateway is not None:
            self.gateway.follow(supervisor)
        supervisor.start()
        return supervisor

    def _open_gateway(self, stack: contextlib.ExitStack) -> None:
        if (address := self._listen or self.checked.listen) or self.checked.expected:
            from palp_core.graph.network.gateway_handle import open_gateway

            report = lambda *event, **data: self.launcher_node.report(*event, **data)  # noqa: E731
            self.gateway = open_gateway(address, self.checked, self.directory.path, report, self._announce)
            stack.callback(self.gateway.close, "the graph has failed", finished=False)

    def _announce(self) -> None:
        """Say where everything is, to those who look into the run directory and to those who ask."""
        pids = (
            {p.spec.name: p.pid for p in self._supervisor.processes} if self._supervisor is not None else {}
        )
        record = run_record(self.checked, self.path, self.directory, pids, composed=self._compose)
        self.launcher_node.record = record if self.gateway is None else self.gateway.described(record)
        self.directory.write(self.launcher_node.record)

    def run(self, until_s: float | None = None) -> RunSummary:
        """Activate, work until the run ends (or until a time on the graph's clock), and reach the safe state.

        Returns:
            How it went. The launch file's report has been written, unless there was a time to stop at.
        """
        until_ns = None if until_s is None else round(until_s * 1e9)
        self._begin_ns = monotonic_ns()
        if (begun := _tell(self.checked, "begin", self._summary())) is not None:
            self._stack.callback(begun.close)
        self.checkpoints.begin()
        self._begun = True
        if self.checked.clock == "sim":
            exit_code, clock_s, activations = self._run_lockstep(until_ns)
        else:
            exit_code, activations = self._run_wall(until_ns), 0
            clock_s = (monotonic_ns() - self._begin_ns + self._gone_ns) / 1e9
        self.summary = self._summary(
            exit_code=exit_code,
            ended="" if exit_code == 0 else f"a node ended the run with exit code {exit_code}",
            clock_s=clock_s,
            wall_s=(monotonic_ns() - self._begin_ns) / 1e9,
            activation_count=activations,
        )
        if exit_code == 0 and until_s is None:
            self.checkpoints.finish()
        if self.checked.report and until_s is None:
            self.summary = self._reported(self.summary)
        return self.summary

    def _run_lockstep(self, until_ns: int | None) -> tuple[int, float, int]:
        checked = self.checked
        ends_run = [i for i, spec in enumerate(checked.nodes) if spec.shutdown_on_exit]
        conductor = Conductor(self._nodes, checked.readers, ends_run, self._show, self._between_instants)
        self._conductor = self.swaps.conductor = conductor
        with ended_after(conductor.shutdown, self._end_order()), self._announcing():
            conductor.activate()
            exit_code = conductor.run(until_ns)
        return exit_code, conductor.now_ns / 1e9, conductor.activation_count

    def _announcing(self) -> contextlib.AbstractContextManager[None]:
        count, resumed = len(self.checked.spawned), self.checkpoints.resumed is not None
        return self.launcher_node.announcing(self.checked.graph, count, resumed=resumed)

    def _show(self, now_ns: int, frame: bytes) -> None:
        self._observe(now_ns, frame)
        self.swaps.observe(now_ns, frame)
        self._keep_frame(now_ns, frame)

    def _keep_frame(self, now_ns: int, frame: bytes) -> None:
        self.observers(now_ns, frame)
        self.recorders.observe(now_ns, frame)

    def _run_wall(self, until_ns: int | None) -> int:
        supervisor = self._supervisor
        assert supervisor is not None
        with ended_after(lambda index: supervisor.shutdown(index, 0), self._end_order()):
            keeping = WallCheckpoints(self.checkpoints, lambda: self.checked, supervisor, *self._told)
            self._gone_ns = keeping.go_on()
            with self._announcing():
                start_ns = monotonic_ns() - self._gone_ns
                if self.gateway is not None:
                    self.gateway.activate(start_ns)
                exit_code = supervisor.run_wall(until_ns, start_ns)
                if self.gateway is not None:
                    self.gateway.close("the graph has come to its end", finished=exit_code == 0)
                return exit_code

    def _swapped(self, checked: CheckedGraph, index: int, done: Done | None) -> None:
        """Go on with another node in the place of one."""
        self.checked = checked
        self.observers.follow(checked)
        self.recorders.follow(checked)
        self._announce()
        if self._conductor is not None:
            self._conductor.rewire(checked.readers)
            if done is not None:
                self._conductor.accept(index, done)

    def plan_swap(self, at_s: float, node: str, run: str, **params: Any) -> None:
        """Let another class take a node's place when it is that time on the graph's clock.

        A swap that fails then ends the run: it would not be what it was planned to be.
        """
        self.swaps.plan(round(at_s * 1e9), SwapRequest(node=node, run=run, params=params))

    def _serve(self) -> None:
        """Do what tools have asked for and what is planned; look for nodes of other hosts that are silent."""
        if self.gateway is not None:
            self.gateway.report_silence()
        self.launcher_node.run_deferred()
        self.swaps.run_due()

    def _between_instants(self) -> None:
        """Between two instants: is the end wanted, does anybody ask?"""
        self._interrupt.check()
        self._serve()
        self._instant_count += 1
        if self._compose and self._instant_count % POLL_INSTANTS == 0:
            self.launcher_node.poll()  # the supervisor does it where there is one

    def _end_order(self) -> list[int]:
        """Nodes that move something first, then graph order."""
        nodes = self.checked.spawned
        return sorted(range(len(nodes)), key=lambda i: (not nodes[i].moves, i))


def _scalar(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
