"""Checkpoints of a lockstep graph whose nodes are processes."""

from collections.abc import Sequence

from palp_core.graph.process.control_messages import Done, Restore, WriteDown
from palp_core.graph.supervision.supervisor import Supervisor


class ProcessKeeper:
    """Has every node write itself down, and lets others go on from there.

    Args:
        supervisor: Has the processes.
    """

    def __init__(self, supervisor: Supervisor) -> None:
        self._supervisor = supervisor

    def keep(self) -> list[bytes]:
        """Write every node down, in graph order."""
        supervisor = self._supervisor
        done = supervisor.work_together({index: WriteDown() for index in range(len(supervisor.names))})
        return [done[index].kept for index in range(len(supervisor.names))]

    def restore(self, kept: Sequence[bytes]) -> list[Done]:
        """Let every node go on from what was written down; return when each is due."""
        done = self._supervisor.work_together({index: Restore(node) for index, node in enumerate(kept)})
        return [done[index] for index in range(len(kept))]
