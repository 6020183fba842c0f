"""De-noise a sweep while it is measured: the wavelet's output with a fixed, stated lag.

A sample of the offline output depends on the :func:`.edge_cone` samples before and after it, so a stream that
is late by the cone gives the offline values to rounding, the sweep's two ends included. A shorter lag shows
the newest samples as if the sweep ended there; how far that is off is :func:`tail_weight` for the linear rule
and in the study ``features`` for the other. The soft rule needs its threshold stated beforehand: the offline
default takes it from the whole sweep.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone, least_samples
from palp_core.units import Float64Array


@dataclass(frozen=True)
class WaveletStreamState:
    """What is remembered between two blocks: plain data, to be kept in a node's state.

    Attributes:
        kept: Last raw samples.
        first: Index in the sweep of the first of them; a multiple of 2^level, so that coefficients fall on
            the same samples as offline.
        told: Samples already given out.
    """

    kept: tuple[float, ...] = ()
    first: int = 0
    told: int = 0


@dataclass(frozen=True)
class WaveletStream:
    """Parameters of the stream.

    Attributes:
        rule: A method of task ``denoise``.
        threshold: Of the soft rule, in the signal's unit, as of
            :func:`.universal_threshold`; None only for rules without one.
        lag: Samples by which the output is late; None: the edge cone, which makes it exact.
        wavelet: Name of a discrete wavelet.
        level: Number of decomposition levels.

    Raises:
        PerceptionError: The soft rule has no threshold, or the lag is negative.
    """

    rule: str = "soft_universal"
    threshold: float | None = None
    lag: int | None = None
    wavelet: str = "db10"
    level: int = 5

    def __post_init__(self) -> None:
        if self.rule == "soft_universal" and not (self.threshold is not None and self.threshold >= 0.0):
            raise PerceptionError(
                "a stream with the soft rule needs its threshold beforehand, as "
                "universal_threshold(noise_sd, samples); only the whole sweep would tell it"
            )
        if self.lag is not None and self.lag < 0:
            raise PerceptionError(f"the stream's lag is {self.lag} samples; the future is not known")

    @property
    def lag_samples(self) -> int:
        """Samples by which the output is late."""
        return edge_cone(self.level, self.wavelet) if self.lag is None else self.lag

    def step(self, state: WaveletStreamState, block: Float64Array) -> tuple[WaveletStreamState, Float64Array]:
        """Return the next state and the samples that are now old enough, in their order.

        Args:
            state: ``WaveletStreamState()`` at the start of a sweep, then what the previous block left.
            block: Raw samples, shape (n,); n may be 0.

        Raises:
            PerceptionError: A sample is not finite.
        """
        if not np.isfinite(block).all():
            raise PerceptionError("block to de-noise holds NaN or infinity; drop the sweep or repair the gap")
        kept = np.concatenate([np.array(state.kept), np.asarray(block, dtype=np.float64)])
        end = state.first + kept.size - self.lag_samples
        if end <= state.told or kept.size < least_samples(self.level, self.wavelet):
            return WaveletStreamState(tuple(kept.tolist()), state.first, state.told), np.empty(0)
        out = self._clean(kept)[state.told - state.first : end - state.first]
        return self._forget(kept, state.first, end), out

    def finish(self, state: WaveletStreamState) -> Float64Array:
        """Return the samples still owed at the end of the sweep.

        Raises:
            PerceptionError: The sweep was shorter than the wavelet needs.
        """
        return self._clean(np.array(state.kept))[state.told - state.first :]

    def whole(self, signal: Float64Array) -> Float64Array:
        """Return what comes out of a whole sweep offline, shape (n,)."""
        return self._clean(signal)

    def _clean(self, samples: Float64Array) -> Float64Array:
        return denoise(
            samples, wavelet=self.wavelet, level=self.level, rule=self.rule, threshold=self.threshold
        )

    def _forget(self, kept: Float64Array, first: int, told: int) -> WaveletStreamState:
        """Keep what later outputs depend on: the cone before them, and a start on the coefficients' grid.

        The end of the sweep may come at once, so at least as much as the wavelet needs stays.
        """
        grid = 2**self.level
        need = min(
            told - edge_cone(self.level, self.wavelet),
            first + kept.size - least_samples(self.level, self.wavelet),
        )
        start = max(first, need // grid * grid)
        return WaveletStreamState(tuple(kept[start - first :].tolist()), start, told)


@lru_cache(maxsize=64)
def tail_weight(lag: int, *, wavelet: str = "db10", level: int = 5) -> float:
    """Return how much an output of the linear rule owes to samples more than ``lag`` after it.

    It is the largest sum of absolute weights over the 2^level phases of the output: 0 at the edge cone. A
    stream of that lag differs from offline by at most this times the largest difference between a future
    sample and the mirrored one that stood for it.
    """
    cone, grid = edge_cone(level, wavelet), 2**level
    size = -(-2 * cone // grid) * grid + 2 * grid
    centre = size // 2 // grid * grid
    response = np.array(
        [
            denoise(row, wavelet=wavelet, level=level, rule="approximation")[centre : centre + grid]
            for row in np.eye(size)
        ]
    )  # [input, phase of the output]
    ahead = np.arange(size)[:, None] - (centre + np.arange(grid))[None, :] > lag
    return float(np.where(ahead, np.abs(response), 0.0).sum(axis=0).max())
