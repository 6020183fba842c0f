"""Nodes that join the graph after the bridge has begun: what the map says of them, once they are there."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from threading import Thread

from palp_core.graph.bag.ros2.definitions import Definitions
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.run_directory import read_record
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.problems import Problems
from palp_core.graph.ros2.field_map import Times
from palp_core.graph.ros2.map_file import MapFile
from palp_core.graph.ros2.plan import AnsweredPorts, BridgePlan, ask_ports, make_plan

LOOK_NS = 500_000_000


class Joining:
    """Looks who has joined, and asks what they have, while messages go on crossing.

    Args:
        graph: The graph.
        awaited: What of the map names nodes that may yet join; None: nothing does.
        definitions: Of message types.
        times: What becomes of times.
        say: Told what of the map cannot be.
    """

    def __init__(
        self,
        graph: RunningGraph,
        awaited: MapFile | None,
        definitions: Definitions,
        times: Times,
        say: Callable[[str], None],
    ) -> None:
        self._graph, self._awaited, self._say = graph, awaited, say
        self._definitions, self._times = definitions, times
        self._known = set(graph.node_names)
        self._look_ns = 0
        self._asked: Future[AnsweredPorts] | None = None

    def plan(self) -> BridgePlan | None:
        """Return what crosses besides from now on, if anything does; never wait for a node."""
        if self._asked is not None:
            return self._planned(self._asked.result()) if self._asked.done() else None
        now_ns = monotonic_ns()
        if self._awaited is not None and now_ns >= self._look_ns:
            self._look_ns = now_ns + LOOK_NS
            record = read_record(self._graph.folder)
            if record is not None and {node.name for node in record.nodes} - self._known:
                self._graph.record = record
                self._asked = _asked_apart(self._graph)
        return None

    def _planned(self, ports: AnsweredPorts) -> BridgePlan:
        assert self._awaited is not None
        problems = Problems()
        plan = make_plan(self._awaited, self._graph, self._times, problems, self._definitions, ports)
        for problem in problems.listed():
            self._say(str(problem))
        fresh = [name for name in plan.parameters if name not in self._known]
        self._asked, self._awaited = None, plan.awaited
        self._known |= set(self._graph.node_names)
        return replace(plan, parameters=fresh)


def _asked_apart(graph: RunningGraph) -> Future[AnsweredPorts]:
    """Ask in a thread: a node that hangs is waited for, for some seconds."""
    future = Future[AnsweredPorts]()

    def ask() -> None:
        try:
            future.set_result(ask_ports(graph))
        except Exception as error:  # noqa: BLE001 - raised by who takes the result
            future.set_exception(error)

    Thread(target=ask, name="ros2 joining", daemon=True).start()
    return future
