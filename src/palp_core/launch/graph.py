"""A graph from its launch file to its end; what ``palp launch`` does, for Python.

::

    with Graph("launch/sim.yaml", policy="markov") as graph:
        summary = graph.run()
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from palp_core.errors import GraphError
from palp_core.launch.check import CheckedGraph, load
from palp_core.launch.composition import Composition
from palp_core.launch.conductor import Conductor, Crew, Observer
from palp_core.launch.fork_client import ForkServer
from palp_core.launch.interrupt import Interrupt, Interrupted
from palp_core.launch.run_directory import NodeEntry, RunDirectory, TopicEntry, record_for
from palp_core.launch.supervisor import Supervisor
from palp_core.runtime.birth import endpoints, load_module
from palp_core.runtime.clock import monotonic_ns
from palp_core.runtime.zmq_bus import Broadcast

__all__ = ["Graph", "RunSummary", "check_file"]


class RunSummary(msgspec.Struct, frozen=True, kw_only=True):
    """How a run went; handed to the launch file's report function.

    Attributes:
        args: The launch file's arguments as resolved.
        params: Parameters of every node, by node.
        clock_s: Time on the graph's clock.
        wall_s: Wall time from activation to the end.
        activation_count: How often a node was given work, in lockstep.
        report: What the launch file's report function says in words; "" if there is none.
    """

    graph: str
    file: str
    clock: str
    seed: int
    composed: bool
    args: dict[str, Any]
    params: dict[str, dict[str, Any]]
    exit_code: int
    clock_s: float
    wall_s: float
    activation_count: int
    report: str = ""


def _checked(path: Path, overrides: Sequence[str], server: ForkServer, folder: RunDirectory) -> CheckedGraph:
    return load(path, overrides, lambda requests, where: server.describe(requests, where, folder.path))


def check_file(path: str | Path, overrides: Sequence[str] = ()) -> CheckedGraph:
    """Check a launch file as a whole without starting anything.

    Raises:
        GraphProblems: Every problem of the file, each with its place.
    """
    folder = RunDirectory(Path(path).stem)
    server = ForkServer()
    try:
        return _checked(Path(path), overrides, server, folder)
    finally:
        server.close()
        folder.remove()


class Graph:
    """A checked graph, started on entry and ended on exit.

    Args:
        path: The launch file.
        compose: All nodes in this process (simulated time only).
        observe: Is shown every frame in lockstep, and progress messages on the wall clock.
        overrides: Arguments as the command line has them, ``name:=value``.
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
        **args: Any,
    ) -> None:
        self.path = Path(path)
        self._compose = compose
        self._observe = observe or _ignore
        self._overrides = [*overrides, *(f"{name}:={_scalar(value)}" for name, value in args.items())]
        self._stack = contextlib.ExitStack()
        self._interrupt = Interrupt()
        self.summary: RunSummary | None = None

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            stack.enter_context(self._interrupt)
            self.directory = RunDirectory(self.path.stem)
            stack.callback(self.directory.release)
            server = ForkServer(self._interrupt)
            stack.callback(server.close)
            try:
                self.checked = _checked(self.path, self._overrides, server, self.directory)
                if self._compose and self.checked.clock != "sim":
                    raise GraphError(
                        f"{self.path}: only a graph with 'clock: sim' can be composed into one process"
                    )
            except (GraphError, Interrupted):  # nothing has run: there are no logs to keep
                server.close()
                self.directory.remove()
                raise
            if self._compose:
                server.close()
                self._crew: Crew = self._composed(stack)
            else:
                self._supervisor = self._supervised(stack, server)
                self._crew = self._supervisor
                self._supervisor.renewed = self._announce
            self._announce()
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()
        if error is None and self.summary is not None and self.summary.exit_code == 0:
            self.directory.remove()  # otherwise its logs may be wanted

    def _composed(self, stack: contextlib.ExitStack) -> Composition:
        handler = logging.FileHandler(self.directory.log("composition"))
        handler.setFormatter(logging.Formatter("[%(levelname)s] [%(name)s]: %(message)s"))
        logger = logging.getLogger("palp")
        logger.addHandler(handler)
        stack.callback(handler.close)
        stack.callback(logger.removeHandler, handler)
        broadcast = Broadcast(*endpoints(str(self.directory.path), "composition"))
        stack.callback(broadcast.close)
        return Composition(self.checked.nodes, self.checked.workspace, broadcast)

    def _supervised(self, stack: contextlib.ExitStack, server: ForkServer) -> Supervisor:
        supervisor = Supervisor(
            self.checked.nodes,
            self.checked.clock,
            self.checked.workspace,
            self.directory.path,
            server,
            self._interrupt,
            self._observe,
        )
        stack.callback(supervisor.close)
        supervisor.start()
        return supervisor

    def _announce(self) -> None:
        folder = str(self.directory.path)
        pids = {} if self._compose else {m.spec.name: m.pid for m in self._supervisor.members}

        def at(node: str) -> tuple[str, str]:
            return endpoints(folder, "composition" if self._compose else node)

        nodes = [NodeEntry(s.name, s.run, pids.get(s.name, 0), *at(s.name)) for s in self.checked.nodes]
        topics = [
            TopicEntry(name, t.type, t.type_hash, t.node, at(t.node)[0], t.json_schema)
            for name, t in self.checked.topics.items()
        ]
        self.directory.write(
            record_for(self.checked.graph, str(self.path), self.checked.clock, nodes, topics)
        )

    def run(self, until_s: float | None = None) -> RunSummary:
        """Activate, work until the run ends (or until a time on the graph's clock), and reach the safe state.

        Returns:
            How it went. The launch file's report has been written if the exit code is 0.
        """
        until_ns = None if until_s is None else round(until_s * 1e9)
        begin_ns = monotonic_ns()
        if self.checked.clock == "sim":
            exit_code, clock_s, activations = self._run_lockstep(until_ns)
        else:
            exit_code, activations = self._run_wall(until_ns), 0
            clock_s = (monotonic_ns() - begin_ns) / 1e9
        checked = self.checked
        self.summary = RunSummary(
            graph=checked.graph,
            file=str(self.path),
            clock=checked.clock,
            seed=checked.seed,
            composed=self._compose,
            args=checked.args,
            params={spec.name: spec.params for spec in checked.nodes},
            exit_code=exit_code,
            clock_s=clock_s,
            wall_s=(monotonic_ns() - begin_ns) / 1e9,
            activation_count=activations,
        )
        if exit_code == 0 and checked.report and until_s is None:
            said = report_function(checked.report, checked.workspace)(self.summary)
            self.summary = msgspec.structs.replace(self.summary, report=said)
        return self.summary

    def _run_lockstep(self, until_ns: int | None) -> tuple[int, float, int]:
        checked, index_of = self.checked, {spec.name: i for i, spec in enumerate(self.checked.nodes)}
        readers = {topic: [index_of[node] for node, _ in ends] for topic, ends in checked.edges.items()}
        ends_run = [i for i, spec in enumerate(checked.nodes) if spec.shutdown_on_exit]
        conductor = Conductor(self._crew, readers, ends_run, self._observe, self._interrupt.check)
        try:
            conductor.activate()
            exit_code = conductor.run(until_ns)
        finally:
            conductor.shutdown(self._end_order())
        return exit_code, conductor.now_ns / 1e9, conductor.activation_count

    def _run_wall(self, until_ns: int | None) -> int:
        try:
            return self._supervisor.run_wall(until_ns)
        finally:
            for index in self._end_order():
                self._supervisor.shutdown(index, 0)

    def _end_order(self) -> list[int]:
        """Nodes that move something first, then graph order."""
        return sorted(range(len(self.checked.nodes)), key=lambda i: (not self.checked.nodes[i].moves, i))


def _ignore(_now_ns: int, _frame: bytes) -> None:
    """Observe nothing."""


def report_function(target: str, workspace: str) -> Callable[[RunSummary], str]:
    """Import the launch file's report function."""
    module_name, _, name = target.partition(":")
    function: Callable[[RunSummary], str] = getattr(load_module(module_name, workspace), name)
    return function


def _scalar(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)
