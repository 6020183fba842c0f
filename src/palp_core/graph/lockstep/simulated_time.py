"""Simulated time as a swap lets it go by, in the middle of a run."""

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.lockstep.conductor import Conductor
from palp_core.graph.process.control_messages import Done, Round
from palp_core.graph.process.probation import LockstepProbation

_STEP_NS = 10_000_000  # how often it is asked whether a probation is over


class SimulatedTime:
    """The time of a graph in lockstep."""

    def __init__(self) -> None:
        self.conductor: Conductor | None = None

    def elapse(self, duration_ns: int) -> None:
        assert self.conductor is not None
        self.conductor.run(self.conductor.now_ns + duration_ns)

    def pass_probation(
        self, probation: LockstepProbation, first: Done, longest_s: float | None, timeout_s: float
    ) -> None:
        """Let time go by until it is clear who goes on, so long at the most, or until the run ends.

        Args:
            probation: Of a node; nodes that work ask it.
            first: What has been published at the change of hands.
            longest_s: How long a successor has to fail; None: until so many handlers have run, however much
                time goes by.
            timeout_s: Then so long of the machine's time at the most: who asked waits.
        """
        conductor = self.conductor
        assert conductor is not None
        conductor.accept(probation.index, first)
        end_ns = None if longest_s is None else conductor.now_ns + round(longest_s * 1e9)
        latest_ns = monotonic_ns() + round(timeout_s * 1e9)
        while not probation.over and conductor.exit_code is None:
            before_ns = conductor.now_ns
            if monotonic_ns() > latest_ns if end_ns is None else before_ns >= end_ns:
                break
            next_ns = before_ns + _STEP_NS
            conductor.run(next_ns if end_ns is None else min(next_ns, end_ns))
            if conductor.now_ns == before_ns:  # the run ends at a time, and this is it
                break
        if probation.failure and not probation.rolled_back:  # it died between two rounds
            conductor.accept(probation.index, probation.work(Round(conductor.now_ns, [])))
