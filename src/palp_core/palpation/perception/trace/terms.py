"""How a sweep was made where it was not made as training's were, and what may be asked for: plain data."""

from __future__ import annotations

import math

import msgspec

from palp_core.palpation.perception.trace.actions import LoadLimits, SweepAction

ANY = LoadLimits(math.inf, math.inf)
"""The limits of what has been swept: none."""


class SweepTerms(msgspec.Struct, frozen=True):
    """A sweep but for its ring; fields as of :class:`.SweepAction`."""

    indentation_m: float
    speed_m_per_s: float
    from_m: float
    to_m: float

    def at(self, ring_m: float) -> SweepAction:
        """Return the action at a position of the ring; errors as of it."""
        return SweepAction(ring_m, self.indentation_m, self.speed_m_per_s, self.from_m, self.to_m)


class Offer(msgspec.Struct, frozen=True):
    """What a trial's next sweep is chosen from.

    Attributes:
        sweeps: Ring position and terms of each.
        torque_n_m: What the expected torque, with its spread, must stay below.
        force_n: What the expected normal force must stay below.
    """

    sweeps: tuple[tuple[float, SweepTerms], ...]
    torque_n_m: float
    force_n: float

    @property
    def actions(self) -> list[SweepAction]:
        """The sweeps as actions; errors as of :class:`.SweepAction`."""
        return [terms.at(ring_m) for ring_m, terms in self.sweeps]

    @property
    def limits(self) -> LoadLimits:
        """What none may come to."""
        return LoadLimits(self.torque_n_m, self.force_n)
