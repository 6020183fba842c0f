"""Nodes that join the graph after the bridge has begun: what of the map crosses once they are there."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.run_directory import read_record
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.node.spec import LAUNCHER
from palp_core.graph.problems import Problems
from palp_core.graph.ros2.maps import Entry
from palp_core.graph.ros2.plan import Crossing, Ports, ask_ports, plan_crossings

LOOK_NS = 500_000_000


class Joining:
    """Plans what crosses: at once of the nodes that are there, later of those that join.

    Attributes:
        awaited: Entries of nodes that may yet join.
    """

    def __init__(self, graph: RunningGraph, entries: list[Entry]) -> None:
        self._graph = graph
        self.awaited = list(entries)
        self._known: set[str] = set()
        self._look_ns = 0
        self._pool = ThreadPoolExecutor(1)  # a node that hangs is waited for, for some seconds
        self._asked: Future[Ports] | None = None

    def plan(self, problems: Problems, ports: Ports | None = None) -> list[Crossing]:
        """Return what of the map crosses from now on, too; mistakes go to ``problems``.

        Where no node can join, an entry of a node that is not there is a mistake.
        """
        graph, there = self._graph, {*self._graph.node_names, LAUNCHER}
        now = [one for one in self.awaited if not graph.record.listen or there.issuperset(one.nodes)]
        self.awaited = [
            one for one in self.awaited if one not in now or (graph.record.listen and not one.nodes)
        ]
        found = plan_crossings(now, graph, ports or ask_ports(graph), problems)
        fresh = [
            one for one in found if one.entry.kind != "parameters" or one.entry.nodes[0] not in self._known
        ]
        self._known |= there
        return fresh

    def plan_joined(self, report: Callable[[str], None]) -> list[Crossing]:
        """Return what crosses since nodes have joined; never wait for a node."""
        if self._asked is not None:
            if not self._asked.done():
                return []
            problems, ports, self._asked = Problems(), self._asked.result(), None
            found = self.plan(problems, ports)
            for problem in problems.listed():
                report(str(problem))
            return found
        now_ns = monotonic_ns()
        if self.awaited and now_ns >= self._look_ns:
            self._look_ns = now_ns + LOOK_NS
            record = read_record(self._graph.folder)
            if record is not None and {node.name for node in record.nodes} - self._known:
                self._graph.record = record
                self._asked = self._pool.submit(ask_ports, self._graph)
        return []
