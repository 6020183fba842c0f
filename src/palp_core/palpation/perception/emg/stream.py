"""From raw EMG to co-contraction and bursts, block by block, with the same bytes as all at once.

Against the muscle, co-contraction is late by half the RMS window, offline as well, for the chain is causal. A
burst states its own lag.
"""

from dataclasses import dataclass

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.emg.bursts import Burst, BurstRule, BurstState, EmgPeak
from palp_core.palpation.perception.emg.emg import EmgChain, EnvelopeState, cocontraction
from palp_core.units import Float64Array


@dataclass(frozen=True)
class StreamState:
    """What the stream remembers between two blocks: plain data, to be kept in a node's state."""

    band: tuple[tuple[float, ...], ...]  # Delays of the band-pass per chain
    squares: tuple[tuple[float, ...], ...]  # Squared samples inside the RMS window per chain
    bursts: BurstState  # Memory of the burst rule


@dataclass(frozen=True, eq=False)
class StreamBlock:
    """What comes out of a block."""

    envelopes: Float64Array  # s_i, the samples' unit, shape (muscles, n)
    cocontraction: Float64Array  # s_CC^N of eq. (3), dimensionless, shape (n,).
    peaks: tuple[EmgPeak, ...]  # Peaks that the block settles; they may lie in earlier blocks
    bursts: tuple[Burst, ...]  # Bursts that it settles, likewise


@dataclass(frozen=True)
class CoContractionStream:
    """Parameters of the stream."""

    chains: tuple[EmgChain, ...]  # Chain of each muscle, with its offset
    reference: float  # Denominator of eq. (3), as of calibration.calibrate.
    rule: BurstRule  # Rule for bursts

    def __post_init__(self) -> None:
        rates = {chain.rate_hz for chain in self.chains} | {self.rule.rate_hz}
        if not self.chains or len(rates) != 1:
            raise PerceptionError(f"an EMG stream needs one rate for all muscles and the bursts, not {rates}")

    def start(self) -> StreamState:
        """Return the state before the first sample."""
        return _pack([chain.start() for chain in self.chains], BurstState())

    def step(self, state: StreamState, samples: Float64Array) -> tuple[StreamState, StreamBlock]:
        """Return the next state and what comes out."""
        if samples.ndim != 2 or len(samples) != len(self.chains):
            raise PerceptionError(f"EMG block has shape {samples.shape}, not ({len(self.chains)}, samples)")
        if len(state.band) != len(self.chains) or len(state.squares) != len(self.chains):
            raise PerceptionError("EMG state is from a stream with other muscles; use a new state")
        steps = [
            chain.step(EnvelopeState(np.array(band), np.array(squares)), block)
            for chain, band, squares, block in zip(
                self.chains, state.band, state.squares, samples, strict=True
            )
        ]
        envelopes = np.array([envelope for _, envelope in steps])
        value = cocontraction(envelopes, self.reference)
        memory, found = self.rule.step(state.bursts, value)
        return _pack([after for after, _ in steps], memory), StreamBlock(
            envelopes, value, found.peaks, found.bursts
        )


def _pack(muscles: list[EnvelopeState], bursts: BurstState) -> StreamState:
    return StreamState(
        band=tuple(tuple(muscle.band.tolist()) for muscle in muscles),
        squares=tuple(tuple(muscle.squares.tolist()) for muscle in muscles),
        bursts=bursts,
    )
