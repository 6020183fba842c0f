"""The reference of co-contraction: the MVC, by a named rule, and rest.

The envelope of EMG is noisy, so its maximum exceeds the contraction: over 5 s by 13 % of a muscle whose
noise is white, and by 30 % of one with the spectrum of surface EMG. The levels that are held against it read
as much too low. A plateau takes the median of the best half second, and off it what choosing the best gains.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.emg.emg import reference
from palp_core.palpation.perception.emg.settings import LOOK_S, MvcRule
from palp_core.units import Float64Array

PLATEAU_S = 0.5
"""Length of a plateau."""

_MAD_TO_SD = 1.4826  # of a normal law
_FLAT = 3.5
"""Most that lies between the quietest hundredth and the quietest tenth of a rest, in standard deviations of
noise: 0.5 to 2.2 were seen where a person rested, and 6 to 24 where simulated people only relaxed."""
_UNKNOWN_SHARE, _UNKNOWN_MOST = 0.8, 0.02
"""Standard deviation of a rest that was not recorded, as a share of it, and at most: its quietest twentieth
says where it is and little of how it moves. Five of the latter are the lowest level."""
_MEDIAN_SD = 0.55
"""Standard deviation of the median of a half second over that of the envelope: white noise, window 150 ms."""


@dataclass(frozen=True)
class Calibration:
    """What co-contraction is measured against."""

    maxima: tuple[float, ...]  # s_i^max of eq. (1), the samples' unit.
    reference: float  # Denominator of eq. (3), the samples' unit.
    rest: float  # Co-contraction at rest, dimensionless
    rest_sd: float  # Standard deviation of it, dimensionless
    window_s: float = 0.0  # RMS window; 0: an envelope that no window has smeared


def look_step(rate_hz: float) -> int:
    """Return the samples from one look at the envelope to the next."""
    return max(1, round(LOOK_S * rate_hz))


def calibrate(
    mvc: Float64Array,
    rest: Float64Array,
    *,
    rate_hz: float,
    window_s: float,
    rule: MvcRule = "plateau",
    rest_known: bool = True,
) -> Calibration:
    """Return what co-contraction is measured against."""
    if mvc.ndim != 2 or mvc.size == 0:
        raise PerceptionError(f"MVC envelopes have shape {mvc.shape}, not (muscles, samples)")
    if rest.shape[1] == 0:
        raise PerceptionError("no envelope at rest; record some seconds of it")
    if rule == "plateau":
        maxima = tuple(plateau(one, rate_hz=rate_hz, window_s=window_s) for one in mvc)
        whole = sum(maxima)
        if not whole > 0.0:
            raise PerceptionError("the MVC recording is silent; check the electrodes and repeat it")
    else:
        maxima = tuple(mvc.max(axis=1).tolist())
        whole = reference(mvc, rule)
    quiet = rest.sum(axis=0) / whole
    if rest_known:
        level = float(np.median(quiet))
        spread = _MAD_TO_SD * float(np.median(np.abs(quiet - level)))
    else:
        lowest, level, low = np.quantile(quiet, (0.01, 0.05, 0.1)).tolist()
        spread = level * scatter(mvc.sum(axis=0), rate_hz=rate_hz, window_s=window_s)
        if low - lowest < _FLAT * spread:  # as flat as noise: the person rested
            spread = max(spread, min(_UNKNOWN_SHARE * level, _UNKNOWN_MOST))
    return Calibration(maxima, whole, level, spread, window_s)


def plateau(envelope: Float64Array, *, rate_hz: float, window_s: float) -> float:
    """Return the strength of the best half second of a contraction, free of the gain from choosing it.

    The medians of its half seconds differ because the contraction does, and by noise. The best is drawn
    towards the middle one by the share of their variance that is noise: all the way in a contraction that
    was held, hardly in one that fades or comes in pushes. A recording shorter than half a second counts as
    one plateau.
    """
    length = min(max(1, round(PLATEAU_S * rate_hz)), envelope.size)
    medians = np.median(sliding_window_view(envelope, length), axis=1)
    best = float(medians.max())
    strong = medians[medians > 0.5 * best]
    if strong.size == 0:
        return best
    middle = float(np.median(strong))
    spread = _MAD_TO_SD * float(np.median(np.abs(strong - middle)))
    noise = _MEDIAN_SD * scatter(envelope, rate_hz=rate_hz, window_s=window_s) * middle
    share = min(1.0, (noise / spread) ** 2) if spread > 0.0 else 1.0
    return best - share * (best - middle)


def scatter(envelope: Float64Array, *, rate_hz: float, window_s: float) -> float:
    """Return the standard deviation of a contraction's envelope over its value, dimensionless.

    It is that of the steps from window to window, which do not see how the contraction itself varies; taken
    where the envelope is above half its largest, with two windows at least, and 0 otherwise.
    """
    apart = max(1, round(window_s * rate_hz))
    before, after = envelope[:-apart], envelope[apart:]
    strong = np.minimum(before, after) > 0.5 * envelope.max()
    if not strong.any():
        return 0.0
    steps = np.log(after[strong] / before[strong])
    return _MAD_TO_SD * float(np.median(np.abs(steps))) / math.sqrt(2.0)
