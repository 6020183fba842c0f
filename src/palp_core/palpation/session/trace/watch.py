"""Follow a sweep as its torque comes: what a node asks, over what its state keeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from msgspec import structs

from palp_core.errors import PalpError
from palp_core.palpation.perception.belief.session_check import Projected
from palp_core.palpation.perception.belief.stopping import StopRule
from palp_core.palpation.perception.trace.bins import sample_times_ns
from palp_core.palpation.perception.trace.terms import ANY, Offer, SweepTerms
from palp_core.palpation.session.trace.reader import (
    FeltSweep,
    TraceMemory,
    TraceReader,
    TraceSoFar,
    action_reader,
    home_of,
    index_of,
    reader_of,
)
from palp_core.palpation.session.trace.settings import TraceSettings
from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class _Choosing:
    """What reads trials whose sweeps are chosen: of so much training, an offer, and what was made."""

    taught: int
    offer: Offer | None
    made: frozenset[tuple[float, SweepTerms]]
    reader: TraceReader

    def serves(self, taught: int, offer: Offer | None, made: set[tuple[float, SweepTerms]]) -> bool:
        """Tell whether it knows all that these trials may meet."""
        if self.taught != taught or not (self.offer is offer or self.offer == offer):
            return False
        return all(one in self.made or self.reader.setting(*one) is not None for one in made)


@dataclass(eq=False)
class TraceWatch:
    """Reads the sweeps of a memory; nothing but the memory has to be handed over.

    Attributes:
        settings: How.
        speed_m_per_s: Of training's sweeps.
    """

    settings: TraceSettings
    speed_m_per_s: float = 0.020
    _made: tuple[int, TraceReader] | None = field(default=None, init=False)
    _choosing: _Choosing | None = field(default=None, init=False)

    def reader(self, memory: TraceMemory) -> TraceReader:
        """Return what reads trials, made of the training that the memory keeps.

        Where a trial's sweeps are chosen, its sweeps so far are among what may be, however they were made.

        Raises:
            PerceptionError: There is none, or the settings and it do not go together.
            MethodError: There is no such filter, or no contact rung is good enough for the scene.
        """
        taught = len(memory.training)
        if memory.offer is not None or any(one.terms is not None for one in memory.felt):
            return self._chosen(memory, taught)
        if self._made is None or self._made[0] != taught:
            self._made = (taught, reader_of(memory.training, self.settings))
        return self._made[1]

    def _chosen(self, memory: TraceMemory, taught: int) -> TraceReader:
        offer, made = memory.offer, {(one.ring_m, one.terms or self.home) for one in memory.felt}
        if self._choosing is None or not self._choosing.serves(taught, offer, made):
            actions = offer.actions if offer is not None else []
            for ring_m, terms in sorted(made, key=lambda one: one[0]):
                if index_of(one := terms.at(ring_m), actions) is None:
                    actions.append(one)
            limits = offer.limits if offer is not None else ANY
            reader = action_reader(memory.training, self.settings, actions, self.home, limits)
            self._choosing = _Choosing(taught, offer, frozenset(made), reader)
        return self._choosing.reader

    @cached_property
    def home(self) -> SweepTerms:
        """How training's sweeps were made."""
        return home_of(self.settings, self.speed_m_per_s)

    def promise(self, memory: TraceMemory, offer: Offer) -> tuple[Float64Array, list[str]]:
        """Return what each sweep of an offer is expected to tell the trial next, and why others are refused.

        From now on the trial is read as one whose sweeps are chosen from it.

        Returns:
            Bits, shape (a,), -1.0 for what must not be asked for, and each reason once.

        Raises:
            PerceptionError: As of :meth:`reader`, or nothing is left of the offer.
            MethodError: As of :meth:`reader`.
        """
        before, memory.offer = memory.offer, offer
        try:
            reader = self.reader(memory)
        except PalpError:
            memory.offer = before
            raise
        assert reader.known is not None
        why = dict.fromkeys(reader.known.refused.values())
        return reader.expected_bits(memory.felt, offer.actions), list(why)

    def add(
        self, memory: TraceMemory, start_ns: int, rate_hz: float, first: int, torque_n_m: Float64Array
    ) -> None:
        """Add samples ``first`` and on of the sweep under way, whose sample 0 was at ``start_ns``."""
        if memory.sweep is not None:
            times_ns = sample_times_ns(start_ns, rate_hz, first, len(torque_n_m))
            memory.sweep.add(self.settings, times_ns, torque_n_m)

    def look(
        self,
        memory: TraceMemory,
        ring_m: float,
        rule: StopRule,
        posteriors: Sequence[Sequence[float]],
        *,
        landed: bool,
    ) -> TraceSoFar | None:
        """Return what the bins that are new say; None where none is, or the sweep is decided or not trained.

        Args:
            memory: With the sweep under way.
            ring_m: Where the ring was sent.
            rule: The stop rule; where it is passed, the sweep is decided once and for all.
            posteriors: After each sweep of the trial before it.
            landed: Whether the ring was re-homed since the sweep before.
        """
        sweep = memory.sweep
        if sweep is None or sweep.decided or len(sweep.bins.done) == sweep.seen:
            return None
        felt = sweep.felt(self.settings, ring_m, landed=memory.lands(ring_m) or landed)
        reader = self._for(memory, felt)
        if reader is None:
            return None
        found = reader.look(memory.felt, felt, sweep.seen, rule, [np.array(p) for p in posteriors])
        sweep.seen, sweep.decided = len(sweep.bins.done), found.bins if found.decided else 0
        return found

    def _for(self, memory: TraceMemory, felt: FeltSweep) -> TraceReader | None:
        """Return what reads the trial with one sweep more; None where nothing was learnt of that."""
        reader = self.reader(structs.replace(memory, felt=[*memory.felt, felt]))
        return reader if reader.setting(felt.ring_m, felt.terms) is not None else None

    def close(self, memory: TraceMemory, ring_m: float, *, landed: bool) -> tuple[Float64Array, bool] | None:
        """End the sweep under way as one of the trial; its bins up to the decision, or all, are the reading.

        Returns:
            The probabilities of the classes and whether the torque fits any; None where the ring was not
            trained.
        """
        sweep = memory.sweep
        if sweep is None:
            return None
        felt = sweep.felt(self.settings, ring_m, landed=memory.lands(ring_m) or landed)
        reader = self._for(memory, felt)
        if reader is None:
            return None
        memory.felt.append(felt)
        return reader.posterior(memory.felt), reader.fits(memory.felt)

    def against_training(self, memory: TraceMemory) -> Projected | None:
        """Return the trial that is over as its session is held against training by it."""
        return self.reader(memory).against_training(memory.felt)
