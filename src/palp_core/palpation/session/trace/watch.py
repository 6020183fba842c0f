"""Follow a sweep as its torque comes: what a node asks, over what its state keeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from palp_core.palpation.perception.belief.session_check import Projected
from palp_core.palpation.perception.belief.stopping import StopRule
from palp_core.palpation.perception.trace.bins import sample_times_ns
from palp_core.palpation.session.trace.reader import (
    TraceMemory,
    TraceReader,
    TraceSoFar,
    reader_of,
)
from palp_core.palpation.session.trace.settings import TraceSettings
from palp_core.units import Float64Array


@dataclass(eq=False)
class TraceWatch:
    """Reads the sweeps of a memory; nothing but the memory has to be handed over.

    Attributes:
        settings: How.
    """

    settings: TraceSettings
    _made: tuple[int, TraceReader] | None = field(default=None, init=False)

    def reader(self, memory: TraceMemory) -> TraceReader:
        """Return what reads trials, made of the training that the memory keeps."""
        taught = len(memory.training)
        if self._made is None or self._made[0] != taught:
            self._made = (taught, reader_of(memory.training, self.settings))
        return self._made[1]

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
        felt, reader = sweep.felt(ring_m, landed=memory.lands(ring_m) or landed), self.reader(memory)
        if reader.setting(ring_m) is None:
            return None
        found = reader.look(memory.felt, felt, sweep.seen, rule, [np.array(p) for p in posteriors])
        sweep.seen, sweep.decided = len(sweep.bins.done), found.bins if found.decided else 0
        return found

    def close(self, memory: TraceMemory, ring_m: float, *, landed: bool) -> tuple[Float64Array, bool] | None:
        """End the sweep under way as one of the trial; its bins up to the decision, or all, are the reading.

        Returns:
            The probabilities of the classes and whether the torque fits any; None where the ring was not
            trained.
        """
        sweep = memory.sweep
        if sweep is None:
            return None
        felt, reader = sweep.felt(ring_m, landed=memory.lands(ring_m) or landed), self.reader(memory)
        if reader.setting(ring_m) is None:
            return None
        memory.felt.append(felt)
        return reader.posterior(memory.felt), reader.fits(memory.felt)

    def against_training(self, memory: TraceMemory) -> Projected | None:
        """Return the trial that is over as its session is held against training by it."""
        return self.reader(memory).against_training(memory.felt)
