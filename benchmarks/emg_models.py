"""EMG whose contractions are known, by three models, to judge rules for bursts and levels.

None is how the rules work: noise in a band, as the simulated subject has it; noise with the spectrum of
surface EMG, after Shwedyk, Balasubramanian and Scott (1977) with the corner frequencies that Farina and
Merletti (2000) give; and a pool of motor units, after Fuglevand, Winter and Patla (1993), whose potentials
are first-order Hermite-Rodriguez functions (Lo Conte, Merletti and Sandri, 1994).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.signal import butter, sosfilt

from palp_core.units import Float64Array

Muscle = Callable[[np.random.Generator, Float64Array], Float64Array]
"""Raw EMG of a muscle whose strength, as a share of MVC, is given per sample; its RMS is 1 at MVC."""

_SETTLE = 3000


def band_noise(rate_hz: float) -> Muscle:
    """Return a muscle that is white noise between 20 and 450 Hz, as strong as it contracts."""
    sections = butter(2, (20.0, 450.0), btype="bandpass", fs=rate_hz, output="sos")
    impulse = np.zeros(6000)
    impulse[0] = 1.0
    scale = 1.0 / np.sqrt(np.sum(sosfilt(sections, impulse) ** 2))

    def emg(rng: np.random.Generator, strength: Float64Array) -> Float64Array:
        white = rng.standard_normal(strength.size + _SETTLE)
        return np.asarray(strength * scale * sosfilt(sections, white)[_SETTLE:])

    return emg


def surface_noise(rate_hz: float, low_hz: float = 60.0, high_hz: float = 120.0) -> Muscle:
    """Return a muscle that is noise shaped as surface EMG, as strong as it contracts.

    Its spectrum is that of |H| = f_h^2 f / ((f^2 + f_l^2) sqrt(f^2 + f_h^2)).

    Args:
        rate_hz: Sampling rate.
        low_hz: f_l.
        high_hz: f_h.
    """

    def emg(rng: np.random.Generator, strength: Float64Array) -> Float64Array:
        size = strength.size
        f = np.fft.rfftfreq(size, 1.0 / rate_hz)
        shape = high_hz**2 * f / ((f**2 + low_hz**2) * np.sqrt(f**2 + high_hz**2))
        noise = np.fft.irfft(np.fft.rfft(rng.standard_normal(size)) * shape, size)
        return np.asarray(strength * noise / np.sqrt(2.0 * np.sum(shape**2) / size))

    return emg


@dataclass(frozen=True)
class MotorUnitPool:
    """A pool of motor units: recruited by size, faster with excitation, their potentials added up.

    Attributes:
        rate_hz: Sampling rate.
        seed: Of where its units lie and how long their potentials are.
        unit_count: Units; the paper's 120.
        threshold_range: Recruitment threshold of the last unit over that of the first; 30.
        size_range: Likewise of the units' sizes; 100.
        slowest_hz: Rate of discharge at recruitment; 8.
        fastest_hz: Largest rate of the first unit; 35.
        fastest_spread_hz: How much less it is for the last; 10.
        gain_hz: Rate per unit of excitation; 1.
        interval_spread: Standard deviation of an interval over its mean; 0.2.
    """

    rate_hz: float
    seed: int = 0
    unit_count: int = 120
    threshold_range: float = 30.0
    size_range: float = 100.0
    slowest_hz: float = 8.0
    fastest_hz: float = 35.0
    fastest_spread_hz: float = 10.0
    gain_hz: float = 1.0
    interval_spread: float = 0.2

    def __call__(self, rng: np.random.Generator, strength: Float64Array) -> Float64Array:
        """Return the pool's EMG: it is driven as much as gives that strength in the long run."""
        drives, strengths = _calibrated(self)
        return self.driven(rng, np.interp(strength, strengths / strengths[-1], drives)) / float(strengths[-1])

    def driven(self, rng: np.random.Generator, drive: Float64Array) -> Float64Array:
        """Return the EMG of an excitation between 0 and 1 per sample, arbitrary unit."""
        rank = np.arange(1, self.unit_count + 1) / self.unit_count
        threshold = self.threshold_range**rank
        fastest = self.fastest_hz - self.fastest_spread_hz * threshold / threshold[-1]
        excitation = drive * (threshold[-1] + (fastest[-1] - self.slowest_hz) / self.gain_hz)
        found = np.zeros(drive.size)
        for unit, potential in enumerate(self._potentials()):
            rate = np.minimum(self.slowest_hz + self.gain_hz * (excitation - threshold[unit]), fastest[unit])
            phase = np.cumsum(np.where(excitation >= threshold[unit], rate, 0.0)) / self.rate_hz
            intervals = rng.normal(1.0, self.interval_spread, int(1.3 * phase[-1]) + 20)
            at = np.cumsum(np.maximum(intervals, 0.2)) - rng.random()
            spikes = np.searchsorted(phase, at[(at > 0.0) & (at < phase[-1])])
            places = spikes[:, None] + (np.arange(potential.size) - (potential.size - 1) // 2)
            inside = (places >= 0) & (places < drive.size)
            shapes = np.broadcast_to(potential, places.shape)
            found += np.bincount(places[inside], shapes[inside], minlength=drive.size)
        return found

    def _potentials(self) -> list[Float64Array]:
        """Return each unit's potential: the larger the unit the larger, the deeper it lies the smaller."""
        rng = np.random.default_rng((self.seed, 1993))
        size = np.sqrt(self.size_range ** (np.arange(1, self.unit_count + 1) / self.unit_count))
        depth, half_s = rng.uniform(0.3, 1.0, self.unit_count), rng.uniform(2e-3, 4e-3, self.unit_count)
        found = []
        for amplitude, width_s in zip(size / depth, half_s, strict=True):
            t = np.arange(-4.0 * width_s, 4.0 * width_s, 1.0 / self.rate_hz) / width_s
            found.append(amplitude * t * np.exp(-(t**2)))
        return found


@lru_cache(maxsize=64)
def _calibrated(pool: MotorUnitPool) -> tuple[Float64Array, Float64Array]:
    """Return excitations, and the RMS that each gives in the long run."""
    drives = np.linspace(0.0, 1.0, 21)
    held = round(10.0 * pool.rate_hz)
    rng = np.random.default_rng((pool.seed, 7))
    raw = [pool.driven(rng, np.full(held, one))[round(pool.rate_hz) :] for one in drives]
    return drives, np.maximum.accumulate([float(np.sqrt(np.mean(one**2))) for one in raw])


MODELS: dict[str, Callable[[float, int], Muscle]] = {
    "noise in a band": lambda rate_hz, _: band_noise(rate_hz),
    "surface EMG noise": lambda rate_hz, _: surface_noise(rate_hz),
    "motor units": lambda rate_hz, seed: MotorUnitPool(rate_hz, seed % 4),
}
"""Muscles by model, of a rate and a seed."""
