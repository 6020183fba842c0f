"""How long the end of a run waits for nodes."""

from __future__ import annotations

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.supervision.interrupt import Interrupt

KILL_NS = 5_000_000_000
"""From the friendly request to the next, less friendly one."""

HURRY_NS = 500_000_000
"""The same for a user who has asked twice: enough for a safe state, if the node is able to reach it."""


class Patience:
    """The time that one step of the end may take.

    Args:
        interrupt: Knows whether the user insists.

    Attributes:
        ending: The end has begun.
    """

    def __init__(self, interrupt: Interrupt) -> None:
        self.ending = False
        self._interrupt = interrupt
        self._begun_ns = 0

    def begin(self) -> None:
        """Begin the end, unless it has begun."""
        if not self.ending:
            self.step()

    def step(self) -> None:
        """Begin its next step."""
        self.ending = True
        self._begun_ns = monotonic_ns()

    @property
    def over(self) -> bool:
        """True when the step has had its time."""
        return monotonic_ns() - self._begun_ns >= (HURRY_NS if self._interrupt.insisted else KILL_NS)
