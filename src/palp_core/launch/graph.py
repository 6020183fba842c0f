"""A graph from its launch file to its end; what ``palp launch`` does, for Python.

::

    with Graph("launch/sim.yaml", policy="markov") as graph:
        summary = graph.run()
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import msgspec

from palp_core.errors import GraphError, NodeError, PalpError, in_words
from palp_core.launch.announcement import announcement
from palp_core.launch.check import CheckedGraph, load
from palp_core.launch.conductor import Conductor, Crew, Observer
from palp_core.launch.fork_client import ForkServer
from palp_core.launch.fork_start import ServerProcess
from palp_core.launch.graph_bus import GraphBus
from palp_core.launch.interrupt import Interrupt, Interrupted
from palp_core.launch.no_door import NoDoor
from palp_core.launch.run_directory import RunDirectory
from palp_core.launch.summary import RunSummary, report_function
from palp_core.runtime.birth import endpoints
from palp_core.runtime.clock import monotonic_ns

if TYPE_CHECKING:
    from palp_core.launch.composition import Composition
    from palp_core.launch.door import Door
    from palp_core.launch.supervisor import Supervisor

__all__ = ["Graph", "RunSummary", "check_file"]

POLL_INSTANTS = 32  # asking a socket costs as much as a message; tools wait a few ms more


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
        started: A fork server's process that was started before.
        overrides: Arguments as the command line has them, ``name:=value``.
        listen: ``tcp://HOST:PORT`` where other hosts may call; the launch file's ``listen`` by default.
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
        **args: Any,
    ) -> None:
        self.path = Path(path)
        self._listen = listen
        self.door: Door | NoDoor = NoDoor()
        self._started = started
        self._compose = compose
        self._observe = observe or _ignore
        self._overrides = [*overrides, *(f"{name}:={_scalar(value)}" for name, value in args.items())]
        self._stack = contextlib.ExitStack()
        self._interrupt = Interrupt()
        self._conductor: Conductor | None = None
        self._supervisor: Supervisor | None = None
        self._instant_count = 0
        self.summary: RunSummary | None = None

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            stack.enter_context(self._interrupt)
            self.directory = RunDirectory(self.path.stem)
            stack.callback(self.directory.release)
            server = ForkServer(self._interrupt, self._started)
            stack.callback(server.close)
            try:
                self.checked = _checked(self.path, self._overrides, server, self.directory)
                if self._compose and self.checked.clock != "sim":
                    raise GraphError(
                        f"{self.path}: only a graph with 'clock: sim' can be composed into one process"
                    )
                self._open_door(stack)
            except (PalpError, Interrupted):  # nothing has run: there are no logs to keep
                server.close()
                self.directory.remove()
                raise
            self.bus = GraphBus(str(self.directory.path), self._now_ns)
            stack.callback(self.bus.close)
            self.bus.answer("stop", lambda _: self._stop())
            if self._compose:
                server.close()
                self._crew: Crew = self._composed(stack)
            else:
                self._crew = self._supervisor = self._supervised(stack, server)
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

    def _now_ns(self) -> int:
        """Return the time on the graph's clock; 0 before it starts."""
        if self._conductor is not None:
            return self._conductor.now_ns
        start_ns = self._supervisor.start_ns if self._supervisor is not None else 0
        return monotonic_ns() - start_ns if start_ns else 0

    def _stop(self) -> dict[str, Any]:
        """End as by Ctrl-C, for a tool that asks."""
        self._interrupt.request()
        return {"ending": self.checked.graph}

    def _composed(self, stack: contextlib.ExitStack) -> Composition:
        from palp_core.launch.composition import Composition
        from palp_core.runtime.zmq_bus import Broadcast

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
        from palp_core.launch.supervisor import Supervisor

        supervisor = Supervisor(
            self.checked.spawned,
            self.checked.clock,
            self.checked.workspace,
            self.directory.path,
            server,
            self._interrupt,
            self._observe,
            self.bus,
        )
        stack.callback(supervisor.close)
        self.door.follow(supervisor)
        supervisor.start()
        return supervisor

    def _open_door(self, stack: contextlib.ExitStack) -> None:
        if (address := self._listen or self.checked.listen) or self.checked.expected:
            from palp_core.launch.door import open_door

            report = lambda *event, **data: self.bus.report(*event, **data)  # noqa: E731
            self.door = open_door(address, self.checked, self.directory.path, report, self._announce)
            stack.callback(self.door.close, "the graph has failed", finished=False)

    def _announce(self) -> None:
        """Say where everything is, to those who look into the run directory and to those who ask."""
        pids = {m.spec.name: m.pid for m in self._supervisor.members} if self._supervisor is not None else {}
        self.bus.record = announcement(
            self.checked, self.path, self.directory.path, pids, self.door, composed=self._compose
        )
        self.directory.write(self.bus.record)

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
        conductor = Conductor(self._crew, readers, ends_run, self._observe, self._look_up)
        self._conductor = conductor
        try:
            with self._told():
                conductor.activate()
                exit_code = conductor.run(until_ns)
        finally:
            conductor.shutdown(self._end_order())
        return exit_code, conductor.now_ns / 1e9, conductor.activation_count

    def _run_wall(self, until_ns: int | None) -> int:
        assert self._supervisor is not None
        try:
            with self._told():
                self.door.activate(start_ns := monotonic_ns())
                exit_code = self._supervisor.run_wall(until_ns, start_ns)
                self.door.close("the graph has come to its end", finished=exit_code == 0)
                return exit_code
        finally:
            for index in self._end_order():
                self._supervisor.shutdown(index, 0)

    def _look_up(self) -> None:
        """Between two instants: is the end wanted, does anybody ask?"""
        self._interrupt.check()
        self._instant_count += 1
        if self._compose and self._instant_count % POLL_INSTANTS == 0:
            self.bus.poll()  # the supervisor does it where there is one

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        """Publish that the graph starts, fails and ends."""
        self.bus.report("started", "", f"{self.checked.graph}: {len(self.checked.spawned)} nodes are ready")
        why = "came to its end"
        try:
            yield
        except NodeError as error:
            self.bus.report("failed", error.node, str(error))
            why = "a node failed"
            raise
        except BaseException as error:
            why = in_words(error)
            raise
        finally:
            self.bus.report("ending", "", f"{self.checked.graph}: {why}")

    def _end_order(self) -> list[int]:
        """Nodes that move something first, then graph order."""
        nodes = self.checked.spawned
        return sorted(range(len(nodes)), key=lambda i: (not nodes[i].moves, i))


def _ignore(_now_ns: int, _frame: bytes) -> None:
    """Observe nothing."""


def _scalar(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)
