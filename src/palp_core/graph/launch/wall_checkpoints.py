"""Checkpoints on the wall clock: the nodes that the launch file names, each kept at the same message."""

from collections.abc import Callable

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.launch.changes_told import ChangesTold
from palp_core.graph.launch.checkpoints import Checkpoints
from palp_core.graph.launch.diagnostics import Diagnostics
from palp_core.graph.launch.methods_told import MethodsTold
from palp_core.graph.supervision.supervisor import Supervisor


class WallCheckpoints:
    """Gathers what nodes write down, and has interrupted ones go on with it.

    Args:
        checkpoints: Where it is written.
        checked: Returns the graph as it is now.
        supervisor: Has the processes.
        diagnostics: What nodes said was wrong.
        methods: Which methods they said they use.
        changes: What was changed of them.
    """

    def __init__(
        self,
        checkpoints: Checkpoints,
        checked: Callable[[], CheckedGraph],
        supervisor: Supervisor,
        diagnostics: Diagnostics,
        methods: MethodsTold,
        changes: ChangesTold,
    ) -> None:
        self._checkpoints, self._checked, self._supervisor = checkpoints, checked, supervisor
        self._diagnostics, self._methods, self._changes = diagnostics, methods, changes
        self._wanted = {spec.name for spec in checked().spawned if spec.keeps_at}
        self._kept: dict[int, dict[str, bytes]] = {}
        if self._wanted:
            supervisor.on_kept = self._take

    def go_on(self) -> int:
        """Hand the nodes what they were, before they are activated; return the time on the graph's clock."""
        found = self._checkpoints.resumed
        if found is None:
            return 0
        self._diagnostics.restore(found.incidents, found.standing)
        self._methods.restore(found.methods)
        self._changes.restore(found.changes)
        self._supervisor.restores = {node.name: node.kept for node in found.nodes}
        return found.now_ns

    def _take(self, name: str, sequence: int, node: bytes) -> None:
        """Take a node that was written down; write the checkpoint once all are there for one message."""
        begun_ns = monotonic_ns()
        self._kept.setdefault(sequence, {})[name] = node
        if self._kept[sequence].keys() < self._wanted:
            return
        kept = self._kept[sequence]
        self._kept = {at: nodes for at, nodes in self._kept.items() if at > sequence}
        checked = self._checked()
        self._checkpoints.write(
            checked,
            [kept.get(spec.name, b"") for spec in checked.spawned],
            begun_ns,
            now_ns=begun_ns - self._supervisor.start_ns,
            incidents=self._diagnostics.incidents,
            standing=self._diagnostics.standing,
            methods=self._methods.told,
            changes=self._changes.told,
        )
