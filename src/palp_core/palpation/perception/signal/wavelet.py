"""De-noise a torque sweep with a discrete wavelet transform.

The method's source names the wavelet (db10) and five levels but no rule for the coefficients, so the rule is
a named choice: task ``denoise`` of the register.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.methods import find
from palp_core.units import Float64Array

if TYPE_CHECKING:
    import pywt

_GAUSSIAN_MAD = 0.6744897501960817  # median of |z|, z standard normal


@lru_cache(maxsize=16)
def _wavelet(name: str) -> pywt.Wavelet:
    import pywt  # takes a tenth of a second, for which a list of methods need not wait

    try:
        return pywt.Wavelet(name)
    except ValueError as error:
        raise PerceptionError(
            f"no discrete wavelet '{name}'; use one of pywt.wavelist(kind='discrete')"
        ) from error


def least_samples(level: int = 5, wavelet: str = "db10") -> int:
    """Return the shortest signal for which ``level`` still has a coefficient free of boundary samples.

    It is (filter length - 1) 2^level: 608 for db10 at level 5.
    """
    return int((_wavelet(wavelet).dec_len - 1) * 2**level)


def edge_cone(level: int = 5, wavelet: str = "db10") -> int:
    """Return how many samples from each end depend on the boundary extension.

    Analysis and synthesis at level J together reach (filter length - 1) (2^J - 1) samples: 589 for db10 at
    level 5.
    """
    return int((_wavelet(wavelet).dec_len - 1) * (2**level - 1))


def soft_universal(coefficients: list[Float64Array]) -> list[Float64Array]:
    """Shrink every detail by sigma sqrt(2 ln n), n the number of coefficients (Donoho, 1995).

    sigma is the median absolute finest detail over that of a standard normal.
    """
    sigma = float(np.median(np.abs(coefficients[-1]))) / _GAUSSIAN_MAD
    threshold = float(sigma * np.sqrt(2.0 * np.log(sum(c.size for c in coefficients))))
    shrunk = [detail - np.clip(detail, -threshold, threshold) for detail in coefficients[1:]]
    return [coefficients[0], *shrunk]


def approximation(coefficients: list[Float64Array]) -> list[Float64Array]:
    """Keep the approximation alone: a linear low-pass at rate / 2^(level + 1), 16 Hz at 1 kHz and level 5."""
    return [coefficients[0], *(np.zeros_like(detail) for detail in coefficients[1:])]


def denoise(
    signal: Float64Array,
    *,
    wavelet: str = "db10",
    level: int = 5,
    rule: str = "soft_universal",
    mode: str = "symmetric",
) -> Float64Array:
    """De-noise a uniformly sampled signal.

    Args:
        signal: Samples, shape (n,), any unit.
        wavelet: Name of a discrete wavelet.
        level: Number of decomposition levels, at least 1.
        rule: A method of task ``denoise``.
        mode: Boundary extension; ``symmetric`` keeps artefacts inside :func:`edge_cone` smallest on ramps.

    Returns:
        Shape (n,), the signal's unit.

    Raises:
        PerceptionError: The signal is not 1-D and finite, or shorter than :func:`least_samples`.
        MethodError: No such rule.
    """
    import pywt

    samples = np.require(signal, np.float64, ["WRITEABLE"])  # pywt refuses a read-only buffer
    if samples.ndim != 1:
        raise PerceptionError(f"signal to de-noise has shape {samples.shape}; pass one channel, shape (n,)")
    if level < 1:
        raise PerceptionError(f"wavelet level is {level}; it must be at least 1")
    least = least_samples(level, wavelet)
    if samples.size < least:
        raise PerceptionError(
            f"signal has {samples.size} samples; {wavelet} at level {level} needs at least {least}: "
            "record a longer sweep or lower the level"
        )
    if not np.isfinite(samples).all():
        raise PerceptionError(
            "signal to de-noise holds NaN or infinity; drop the sweep or repair the gap first"
        )
    if mode not in pywt.Modes.modes:
        raise PerceptionError(f"no boundary mode '{mode}'; use one of {', '.join(pywt.Modes.modes)}")
    kept = find("denoise", rule).target
    coefficients = pywt.wavedec(samples, _wavelet(wavelet), mode=mode, level=level)
    restored = pywt.waverec(kept(coefficients), _wavelet(wavelet), mode=mode)
    return np.asarray(restored[: samples.size], dtype=np.float64)
