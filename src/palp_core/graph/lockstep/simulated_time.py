"""Simulated time as a swap lets it go by, in the middle of a run."""

from palp_core.graph.lockstep.conductor import Conductor
from palp_core.graph.process.control_messages import Done, Round
from palp_core.graph.process.probation import LockstepProbation

_STEP_NS = 10_000_000  # how often it is asked whether a probation is over


class SimulatedTime:
    """The time of a graph in lockstep.

    Attributes:
        conductor: Drives the nodes; None before the run.
    """

    def __init__(self) -> None:
        self.conductor: Conductor | None = None

    def elapse(self, duration_ns: int) -> None:
        """Let so much time go by."""
        assert self.conductor is not None
        self.conductor.run(self.conductor.now_ns + duration_ns)

    def pass_probation(self, probation: LockstepProbation, first: Done, longest_ns: int) -> None:
        """Let time go by until it is clear who goes on, so long at the most, or until the run ends.

        Args:
            probation: Of a node; nodes that work ask it.
            first: What has been published at the change of hands.
            longest_ns: How long a successor has to fail.
        """
        conductor = self.conductor
        assert conductor is not None
        conductor.accept(probation.index, first)
        end_ns = conductor.now_ns + longest_ns
        while not probation.over and conductor.exit_code is None and conductor.now_ns < end_ns:
            before_ns = conductor.now_ns
            conductor.run(min(before_ns + _STEP_NS, end_ns))
            if conductor.now_ns == before_ns:  # the run ends at a time, and this is it
                break
        if probation.failure and not probation.fell_back:  # it died between two rounds
            conductor.accept(probation.index, probation.work(Round(conductor.now_ns, [])))
