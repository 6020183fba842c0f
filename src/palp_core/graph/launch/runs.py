"""The two ways in which a graph runs: on the machine's clock, and in rounds of simulated time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.lockstep.conductor import Conductor, Observer
from palp_core.graph.node.spec import RECORDER, NodeSpec
from palp_core.graph.process.control_messages import Done
from palp_core.graph.supervision.interrupt import ended_after
from palp_core.graph.supervision.supervisor import Supervisor
from palp_core.graph.swap.step_engine import SwapHost

if TYPE_CHECKING:
    from palp_core.graph.network.gateway_handle import GatewayHandle


class LockstepRun:
    def __init__(
        self, nodes: SwapHost, checked: CheckedGraph, observe: Observer, check: Callable[[], None]
    ) -> None:
        ends_run = [i for i, spec in enumerate(checked.nodes) if spec.shutdown_on_exit]
        self.nodes, self._order = nodes, end_order(checked.spawned)
        self.conductor = Conductor(nodes, checked.readers, ends_run, observe, check)

    @property
    def now_ns(self) -> int:
        return self.conductor.now_ns

    @property
    def activation_count(self) -> int:
        """How often a node was given work."""
        return self.conductor.activation_count

    def clock_s(self, _wall_s: float) -> float:
        return self.now_ns / 1e9

    def go(self, until_ns: int | None, announcing: AbstractContextManager[None]) -> int:
        """Activate, work, and bring every node to its safe state; return the exit code."""
        with ended_after(self.conductor.shutdown, self._order), announcing:
            self.conductor.activate()
            return self.conductor.run(until_ns)

    def replace(self, checked: CheckedGraph, index: int, done: Done | None) -> None:
        """Go on with another node in the place of one, and with what it has published."""
        self.conductor.rewire(checked.readers)
        if done is not None:
            self.conductor.accept(index, done)


class WallRun:
    """A run on the machine's clock."""

    activation_count = 0

    def __init__(self, supervisor: Supervisor, checked: CheckedGraph, gateway: GatewayHandle | None) -> None:
        self._supervisor, self._gateway = supervisor, gateway
        self._order, self.nodes, self.conductor = end_order(checked.spawned), supervisor, None
        self._gone_ns = 0

    def resume(self, nodes: dict[str, bytes], gone_ns: int) -> None:
        """Go on where a run was interrupted: its nodes by name, its time on the graph's clock."""
        self._supervisor.restores, self._gone_ns = nodes, gone_ns

    @property
    def now_ns(self) -> int:
        """Time on the graph's clock; 0 before it starts."""
        start_ns = self._supervisor.start_ns
        return monotonic_ns() - start_ns if start_ns else 0

    def clock_s(self, wall_s: float) -> float:
        return wall_s + self._gone_ns / 1e9

    def go(self, until_ns: int | None, announcing: AbstractContextManager[None]) -> int:
        """Activate, work, and bring every node to its safe state; return the exit code."""
        with ended_after(lambda index: self._supervisor.shutdown(index, 0), self._order), announcing:
            start_ns = monotonic_ns() - self._gone_ns
            if self._gateway is not None:
                self._gateway.activate(start_ns)
            exit_code = self._supervisor.run_wall(until_ns, start_ns)
            if self._gateway is not None:
                self._gateway.close("the graph has come to its end", finished=exit_code == 0)
            return exit_code

    def replace(self, checked: CheckedGraph, index: int, done: Done | None) -> None:
        """Go on with another node in the place of one: the swap has moved its readers."""


def end_order(nodes: Sequence[NodeSpec]) -> list[int]:
    """Return the order in which nodes end: those that move something first, recorders last."""
    return sorted(range(len(nodes)), key=lambda i: (nodes[i].run == RECORDER, not nodes[i].moves, i))
