"""Checkpoints of a graph in lockstep: between two instants of simulated time all nodes are at rest."""

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.launch.changes_told import ChangesTold
from palp_core.graph.launch.checkpoints import Checkpoints
from palp_core.graph.launch.diagnostics import Diagnostics
from palp_core.graph.launch.methods_told import MethodsTold
from palp_core.graph.lockstep.conductor import Conductor, LockstepNodes, NodeKeeper
from palp_core.graph.recording.recorders import Recorders
from palp_core.graph.supervision.launcher_node import LauncherNode


class LockstepCheckpoints:
    """Writes down all that a run in lockstep is, and goes on from there.

    Args:
        checkpoints: Where it is written.
        nodes: Those of the graph.
        conductor: Has the time.
        diagnostics: What nodes said was wrong.
        methods: Which methods they said they use.
        changes: What was changed of them.
        launcher_node: What the launcher itself says.
        recorders: Whose bags are to have all that was published before.
    """

    def __init__(
        self,
        checkpoints: Checkpoints,
        nodes: LockstepNodes,
        conductor: Conductor,
        diagnostics: Diagnostics,
        methods: MethodsTold,
        changes: ChangesTold,
        launcher_node: LauncherNode,
        recorders: Recorders,
    ) -> None:
        self._checkpoints, self._conductor, self._launcher_node = checkpoints, conductor, launcher_node
        self._recorders = recorders
        self._diagnostics, self._methods, self._changes = diagnostics, methods, changes
        self._keeper = _keeper(nodes)

    def go_on(self) -> bool:
        """Put everything where it was at the checkpoint that the run goes on from; False if it begins."""
        found = self._checkpoints.resumed
        if found is None:
            return False
        self._diagnostics.restore(found.incidents, found.standing)
        self._methods.restore(found.methods)
        self._changes.restore(found.changes)
        self._launcher_node.go_on(found.said)
        nodes = self._keeper.restore([node.kept for node in found.nodes])
        self._conductor.go_on(found.now_ns, found.activation_count, nodes)
        return True

    def write(self, checked: CheckedGraph) -> None:
        """Write down where everything is, between two instants."""
        begun_ns = monotonic_ns()
        self._recorders.flush()
        self._checkpoints.write(
            checked,
            self._keeper.keep(),
            begun_ns,
            now_ns=self._conductor.now_ns,
            activation_count=self._conductor.activation_count,
            incidents=self._diagnostics.incidents,
            standing=self._diagnostics.standing,
            methods=self._methods.told,
            changes=self._changes.told,
            said=self._launcher_node.said,
            bag=self._recorders.bag,
        )


def _keeper(nodes: LockstepNodes) -> NodeKeeper:
    """Return what writes down the nodes of a graph, and lets others go on from there."""
    from palp_core.graph.supervision.supervisor import Supervisor

    if isinstance(nodes, Supervisor):
        from palp_core.graph.supervision.process_keeper import ProcessKeeper

        return ProcessKeeper(nodes)
    from palp_core.graph.lockstep.composed_keeper import ComposedKeeper
    from palp_core.graph.lockstep.composition import Composition

    assert isinstance(nodes, Composition)
    return ComposedKeeper(nodes)
