"""Ways to take the noise off a torque sweep, by the names that ``palp session reanalyse --smoother`` takes.

The source's is db10 at five levels (:mod:`.wavelet`); the others are what it is to be judged against. Each
gives every sample from samples at most :attr:`lag` later, so each can run while the sweep is measured; the
study ``features`` charts their errors against lag and cost.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
import scipy

from palp_core.errors import MethodError, PerceptionError
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.units import Float64Array


class Smoother(Protocol):
    """Anything that takes noise off a uniformly sampled sweep."""

    @property
    def lag(self) -> int:
        """How many samples after a sample its value is known."""
        ...

    @property
    def edge(self) -> int:
        """Samples at each end that depend on how the sweep is continued beyond it."""
        ...

    def apply(self, signal: Float64Array) -> Float64Array:
        """Return the smoothed sweep, shape (n,), the signal's unit; sample i belongs to sample i."""
        ...


def _checked(signal: Float64Array, least: int) -> Float64Array:
    samples = np.asarray(signal, dtype=np.float64)
    if samples.ndim != 1 or samples.size < least or not np.isfinite(samples).all():
        raise PerceptionError(
            f"sweep to smooth has shape {samples.shape}; need (n,), n >= {least}, all finite"
        )
    return samples


@dataclass(frozen=True)
class _Wavelet:
    level: int = 5
    wavelet: str = "db10"

    @property
    def lag(self) -> int:
        """The edge cone; a threshold is the whole sweep's unless it is stated."""
        return edge_cone(self.level, self.wavelet)

    @property
    def edge(self) -> int:
        """The edge cone."""
        return self.lag


@dataclass(frozen=True)
class WaveletSoft(_Wavelet):
    """db10 at five levels with the soft universal threshold; the default.

    Attributes:
        level: Number of decomposition levels.
        wavelet: Name of a discrete wavelet.
    """

    def apply(self, signal: Float64Array) -> Float64Array:
        return denoise(signal, wavelet=self.wavelet, level=self.level)


@dataclass(frozen=True)
class WaveletApproximation(_Wavelet):
    """db10 at five levels, the approximation alone; attributes as of :class:`WaveletSoft`."""

    def apply(self, signal: Float64Array) -> Float64Array:
        return denoise(signal, wavelet=self.wavelet, level=self.level, rule="approximation")


@dataclass(frozen=True)
class SavitzkyGolay:
    """A polynomial fitted to a window about each sample (Savitzky and Golay, 1964).

    Attributes:
        half: Samples on either side of the middle one (assumed: 50, so 101 ms or 2 mm of a sweep).
        degree: Of the polynomial (assumed).
    """

    half: int = 50
    degree: int = 3

    @property
    def lag(self) -> int:
        """Half the window."""
        return self.half

    @property
    def edge(self) -> int:
        """Half the window."""
        return self.half

    def apply(self, signal: Float64Array) -> Float64Array:
        samples = _checked(signal, 2 * self.half + 1)
        return np.asarray(scipy.signal.savgol_filter(samples, 2 * self.half + 1, self.degree, mode="interp"))


@lru_cache(maxsize=32)
def _low_pass(order: int, cutoff: float) -> Float64Array:
    return np.asarray(scipy.signal.butter(order, 2.0 * cutoff, output="sos"))


@dataclass(frozen=True)
class LowPass:
    """A causal Butterworth, shifted back by its delay at low frequencies.

    Attributes:
        cutoff_per_sample: Cut-off over the sampling rate (assumed: 0.02, 20 Hz at 1 kHz).
        order: Of the Butterworth (assumed).

    Raises:
        PerceptionError: The cut-off is not between 0 and half the sampling rate.
    """

    cutoff_per_sample: float = 0.02
    order: int = 2

    def __post_init__(self) -> None:
        if not 0.0 < self.cutoff_per_sample < 0.5:
            raise PerceptionError(
                f"cut-off of {self.cutoff_per_sample} of the rate; it must be within 0, 0.5"
            )

    @property
    def lag(self) -> int:
        """Its group delay at frequency 0, rounded: sum of sin((2k - 1) pi / 2n) / (2 tan(pi f_c)), k to n."""
        angles = (2.0 * np.arange(1, self.order + 1) - 1.0) * np.pi / (2.0 * self.order)
        delay = float(np.sin(angles).sum() / (2.0 * np.tan(np.pi * self.cutoff_per_sample)))
        return round(delay)

    @property
    def edge(self) -> int:
        """Ten delays, after which its start has decayed below 1e-6 of a step."""
        return 10 * self.lag

    def apply(self, signal: Float64Array) -> Float64Array:
        samples = _checked(signal, 1)
        sections = _low_pass(self.order, self.cutoff_per_sample)
        held = np.concatenate([samples, np.full(self.lag, samples[-1])])
        passed, _ = scipy.signal.sosfilt(sections, held, zi=scipy.signal.sosfilt_zi(sections) * samples[0])
        return np.asarray(passed[self.lag :])


@dataclass(frozen=True)
class Nothing:
    """The sweep as it was measured."""

    @property
    def lag(self) -> int:
        """None at all."""
        return 0

    @property
    def edge(self) -> int:
        """None at all."""
        return 0

    def apply(self, signal: Float64Array) -> Float64Array:
        return _checked(signal, 1)


SMOOTHERS: dict[str, Callable[[], Smoother]] = {
    "none": Nothing,
    "low_pass": LowPass,
    "db10_approximation": WaveletApproximation,
    "db10_soft": WaveletSoft,
    "savitzky_golay": SavitzkyGolay,
}
"""At their usual settings, the cheapest first."""


def smoother(name: str) -> Smoother:
    """Return a smoother by name, at its usual setting.

    Raises:
        MethodError: There is no smoother of that name.
    """
    if name not in SMOOTHERS:
        raise MethodError(f"no smoother '{name}'; use {', '.join(SMOOTHERS)}")
    return SMOOTHERS[name]()
