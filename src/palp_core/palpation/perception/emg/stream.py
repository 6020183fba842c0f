"""Muscles' raw EMG to co-contraction and bursts, block by block, equal to the whole recording at once.

Co-contraction comes without lag: the value at a sample is the same as offline, to rounding. Against the
muscle it is late by :attr:`CoContractionStream.delay_s`, offline as well, for the chain is causal. A burst
states its own lag.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.emg.bursts import Burst, BurstRule, BurstState, EmgPeak, Found
from palp_core.palpation.perception.emg.emg import EmgChain, EnvelopeState, cocontraction, without_common
from palp_core.palpation.perception.emg.settings import Crosstalk
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

    # s_i, the samples' unit, shape (muscles, n); without what is common if that is removed
    envelopes: Float64Array
    cocontraction: Float64Array  # s_CC^N of eq. (3), dimensionless, shape (n,).
    peaks: tuple[EmgPeak, ...]  # Peaks that the block settles; they may lie in earlier blocks
    bursts: tuple[Burst, ...]  # Bursts that it settles, likewise


@dataclass(frozen=True)
class CoContractionStream:
    """Parameters of the stream."""

    chains: tuple[EmgChain, ...]  # Chain of each muscle, with its offset
    reference: float  # Denominator of eq. (3), as of calibration.calibrate.
    rule: BurstRule  # Rule for bursts
    crosstalk: Crosstalk = "keep"  # What becomes of what two muscles' recordings have in common

    def __post_init__(self) -> None:
        rates = {chain.rate_hz for chain in self.chains} | {self.rule.rate_hz}
        if not self.chains or len(rates) != 1:
            raise PerceptionError(f"an EMG stream needs one rate for all muscles and the bursts, not {rates}")
        _with_sum(self.chains, self.crosstalk)  # it refuses what does not fit

    @property
    def delay_s(self) -> float:
        """Time by which the middle of the RMS window is late; the band-pass adds milliseconds."""
        chain = self.chains[0]
        return (chain.window_samples - 1) / 2.0 / chain.rate_hz

    def start(self) -> StreamState:
        """Return the state before the first sample."""
        return _pack([chain.start() for chain in _with_sum(self.chains, self.crosstalk)], BurstState())

    def step(self, state: StreamState, samples: Float64Array) -> tuple[StreamState, StreamBlock]:
        """Return the next state and what comes out."""
        if samples.ndim != 2 or len(samples) != len(self.chains):
            raise PerceptionError(f"EMG block has shape {samples.shape}, not ({len(self.chains)}, samples)")
        chains = _with_sum(self.chains, self.crosstalk)
        if len(state.band) != len(chains) or len(state.squares) != len(chains):
            raise PerceptionError("EMG state is of a stream with other muscles; start afresh")
        blocks = [*samples, samples.sum(axis=0)][: len(chains)]
        steps = [
            chain.step(EnvelopeState(np.array(band), np.array(squares)), block)
            for chain, band, squares, block in zip(chains, state.band, state.squares, blocks, strict=True)
        ]
        envelopes = _own([envelope for _, envelope in steps], self.chains[0].window_s, self.crosstalk)
        value = cocontraction(envelopes, self.reference)
        memory, found = self.rule.step(state.bursts, value)
        return _pack([after for after, _ in steps], memory), StreamBlock(
            envelopes, value, found.peaks, found.bursts
        )

    def finish(self, state: StreamState) -> Found:
        """Return what is still open at the end of the recording."""
        return self.rule.finish(state.bursts)

    def whole(self, samples: Float64Array) -> StreamBlock:
        """Return what comes out of a whole recording, shape (muscles, n)."""
        state, block = self.step(self.start(), samples)
        last = self.finish(state)
        return StreamBlock(
            block.envelopes, block.cocontraction, block.peaks + last.peaks, block.bursts + last.bursts
        )


def envelopes_of(
    chains: Sequence[EmgChain], samples: Float64Array, crosstalk: Crosstalk = "keep"
) -> Float64Array:
    """Return the envelopes of a whole recording as a stream gives them, shape (muscles, n)."""
    blocks = [*samples, samples.sum(axis=0)]
    return _own(
        [chain.envelope(one) for chain, one in zip(_with_sum(chains, crosstalk), blocks, strict=False)],
        chains[0].window_s,
        crosstalk,
    )


def _with_sum(chains: Sequence[EmgChain], crosstalk: Crosstalk) -> list[EmgChain]:
    """Return the muscles' chains and, where it is needed, that of the sum of their samples."""
    if crosstalk == "keep":
        return list(chains)
    if len(chains) != 2:
        raise PerceptionError(
            f"crosstalk is what two muscles have in common; there are {len(chains)}: keep it"
        )
    return [*chains, replace(chains[0], offset=sum(one.offset for one in chains))]


def _own(envelopes: Sequence[Float64Array], window_s: float, crosstalk: Crosstalk) -> Float64Array:
    if crosstalk == "keep":
        return np.array(envelopes)
    first, second, together = envelopes
    return without_common(first, second, together, window_s)


def _pack(muscles: list[EnvelopeState], bursts: BurstState) -> StreamState:
    return StreamState(
        band=tuple(tuple(muscle.band.tolist()) for muscle in muscles),
        squares=tuple(tuple(muscle.squares.tolist()) for muscle in muscles),
        bursts=bursts,
    )
