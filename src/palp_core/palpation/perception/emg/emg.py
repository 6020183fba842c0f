"""From surface EMG of a flexor and an extensor to co-contraction.

Offset removal, band-pass, rectification, root mean square, then eqs. (1) to (3). The chain is causal and runs
block by block with its memory carried outside, so a stream and a file give the same envelope whatever the
blocks. From the co-contraction, :mod:`palp_core.palpation.perception.emg.levels` makes peaks and levels.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import scipy

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class EnvelopeState:
    """What the chain of one muscle remembers between two blocks."""

    band: Float64Array  # Delays of the band-pass, shape (2 * sections,)
    squares: Float64Array  # Last squared samples inside the RMS window, shape (window - 1,)


@lru_cache(maxsize=8)
def _band_pass(order: int, low_hz: float, high_hz: float, rate_hz: float) -> Float64Array:
    return np.asarray(
        scipy.signal.butter(order, (low_hz, high_hz), btype="bandpass", fs=rate_hz, output="sos")
    )


@dataclass(frozen=True)
class EmgChain:
    """Parameters of the chain, for one muscle."""

    # Constant to subtract, in the samples' unit (volts or counts), as of find_offset. The band-pass would
    # remove it too, but only after a transient that becomes the largest value of an MVC.
    offset: float = 0.0
    rate_hz: float = 1500.0  # Sampling rate; 1500 as published
    low_hz: float = 20.0  # Lower edge; 20, below which movement artefacts lie
    high_hz: float = 450.0  # Upper edge; 450, above which surface EMG has little power
    order: int = 2  # Order of the Butterworth prototype (assumed)
    window_s: float = 0.05  # RMS window (assumed; not published)

    def __post_init__(self) -> None:
        if not 0.0 < self.low_hz < self.high_hz < self.rate_hz / 2.0:
            raise PerceptionError(
                f"EMG band {self.low_hz} to {self.high_hz} Hz does not fit below half of {self.rate_hz} Hz"
            )
        if self.window_samples < 1:
            raise PerceptionError(f"RMS window of {self.window_s} s is shorter than one sample")

    @property
    def window_samples(self) -> int:
        """Samples in the RMS window."""
        return round(self.window_s * self.rate_hz)

    def start(self) -> EnvelopeState:
        """Return the state before the first sample: silence at the offset."""
        sections = len(_band_pass(self.order, self.low_hz, self.high_hz, self.rate_hz))
        return EnvelopeState(np.zeros(2 * sections), np.zeros(self.window_samples - 1))

    def step(self, state: EnvelopeState, samples: Float64Array) -> tuple[EnvelopeState, Float64Array]:
        """Return the next state and the envelope of a block.

        Rectifying before squaring changes nothing, so the RMS is of both.

        Returns:
            The state, and the RMS over the window that ends at each sample, shape (n,), the samples' unit.
        """
        block = np.asarray(samples, dtype=np.float64)
        if not np.isfinite(block).all():
            raise PerceptionError(
                "EMG block holds NaN or infinity; bridge the gap and mark it before the chain"
            )
        sections = _band_pass(self.order, self.low_hz, self.high_hz, self.rate_hz)
        if state.band.size != 2 * len(sections) or state.squares.size != self.window_samples - 1:
            raise PerceptionError("EMG state is from a chain with another order or window; use a new state")
        if block.size == 0:
            return state, block
        delays = state.band.reshape(len(sections), 2)
        passed, delays = scipy.signal.sosfilt(sections, block - self.offset, zi=delays)
        squares = np.concatenate([state.squares, passed * passed])
        window = np.ones(self.window_samples) / self.window_samples
        envelope = np.sqrt(np.convolve(squares, window, mode="valid"))
        return EnvelopeState(delays.ravel(), squares[block.size :]), envelope

    def envelope(self, samples: Float64Array) -> Float64Array:
        """Return the envelope of a whole recording, shape (n,); the first window ramps up from silence."""
        return self.step(self.start(), samples)[1]


def find_offset(rest: Float64Array) -> float:
    """Return the constant under a recording: its median, which bursts hardly move."""
    if rest.size == 0:
        raise PerceptionError("no sample to find the EMG offset from; record a second at rest")
    return float(np.median(rest))


def normalise(envelope: Float64Array, maximum: float) -> Float64Array:
    """Return s_i^N = s_i / s_i^max, eq. (1), dimensionless."""
    if not maximum > 0.0:
        raise PerceptionError(f"s_max is {maximum}; repeat the MVC recording")
    return np.asarray(envelope / maximum)


def reference(
    mvc: Float64Array, denominator: Literal["sum_of_maxima", "maximum_of_sum"] = "sum_of_maxima"
) -> float:
    """Return the denominator of eq. (3) from MVC envelopes."""
    if mvc.ndim != 2 or mvc.size == 0:
        raise PerceptionError(f"MVC envelopes have shape {mvc.shape}, not (muscles, samples)")
    if denominator == "sum_of_maxima":
        value = float(mvc.max(axis=1).sum())
    elif denominator == "maximum_of_sum":
        value = float(mvc.sum(axis=0).max())
    else:
        raise PerceptionError(f"no denominator '{denominator}'; use 'sum_of_maxima' or 'maximum_of_sum'")
    if not value > 0.0:
        raise PerceptionError("the MVC recording is silent; check the electrodes and repeat it")
    return value


def cocontraction(envelopes: Float64Array, mvc_reference: float) -> Float64Array:
    """Return s_CC^N, eqs. (2) and (3): summed envelopes over the reference, dimensionless, shape (n,)."""
    return normalise(envelopes.sum(axis=0), mvc_reference)
