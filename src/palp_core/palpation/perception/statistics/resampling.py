"""Intervals and comparisons over sessions: the session, not the trial, is the unit of replication.

Trials of one session share its training and its mountings and are not independent facts. Sessions are drawn
with replacement (cluster bootstrap; Davison and Hinkley, "Bootstrap Methods and their Application", 1997,
sec. 3.8), and policies that met the same sessions are compared within them.

Plain percentiles of resampled means are too narrow for few sessions, for two known reasons (Hesterberg, "What
Teachers Should Know About the Bootstrap", 2015, sec. 3): a resample varies by n - 1 in n of what sessions do,
and its spread is taken for known. Both are made good here by the factor that is right for normal values; of
intervals that say 95 %, plain ones of 4, 8 and 20 normal values hold the mean in 79, 88 and 93 %. Where
nearly all sessions are at 100 % no interval from few of them sees the rare bad one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.statistics.statistics import reliability_bins, wilson
from palp_core.units import Float64Array


@dataclass(frozen=True)
class SessionMean:
    """A mean over sessions with a 95 % interval."""

    value: float  # The mean
    # Lower bound; equal to the value with fewer than two sessions or where all agree, which is not certainty:
    # such sessions do not show how much others would differ
    low: float
    high: float  # Upper bound
    session_count: int  # Sessions


@dataclass(frozen=True)
class PairedDifference:
    """Two methods on the same sessions."""

    first: str  # Name of the first
    second: str  # Name of the second
    difference: SessionMean  # Mean of first minus second, with its interval over sessions
    p: float  # Sign-flip p-value, two-sided
    p_holm: float  # The same within its family (Holm, 1979)


def widened(session_count: int, confidence: float = 0.95) -> float:
    """Return by how much percentiles of resampled sessions are too near their mean; for two sessions or more.

    >>> print(*(round(widened(count), 2) for count in (2, 8, 20, 40)))
    9.17 1.29 1.1 1.05
    """
    tail = 0.5 * (1.0 - confidence)
    student = scipy.special.stdtrit(session_count - 1, tail) / scipy.special.ndtri(tail)
    return float(student * np.sqrt(session_count / (session_count - 1)))


def cluster_bootstrap(
    values: Sequence[float] | Float64Array,
    rng: np.random.Generator,
    *,
    resamples: int = 2000,
    confidence: float = 0.95,
    within: tuple[float, float] = (-np.inf, np.inf),
) -> SessionMean:
    """Return the mean of a per-session value with its percentile interval over resampled sessions.

    The ends are moved away from the mean by t / z * sqrt(s / (s - 1)), Student's t with s - 1 degrees of
    freedom: :func:`widened`.

    Args:
        values: One value per session, equally many trials in each, shape (s,).
        rng: Draws the resamples.
        resamples: Their number.
        confidence: Of the interval.
        within: Where the value can lie, as 0 to 1 for a share; the interval is cut there.

    Raises:
        PerceptionError: There is no session, a value is not finite, or the interval is none.
    """
    if resamples < 1 or not 0.0 < confidence < 1.0:
        raise PerceptionError(
            f"an interval of {confidence} from {resamples} resamples; need 0 to 1, 1 resample"
        )
    found = np.asarray(values, dtype=np.float64)
    if found.size == 0 or found.ndim != 1 or not np.isfinite(found).all():
        raise PerceptionError("an interval over sessions needs one finite value a session, and a session")
    mean = float(found.mean())
    if found.size == 1 or float(np.ptp(found)) == 0.0:
        return SessionMean(mean, mean, mean, found.size)
    means = found[rng.integers(0, found.size, (resamples, found.size))].mean(axis=1)
    tail = 0.5 * (1.0 - confidence)
    ends = np.quantile(means, [tail, 1.0 - tail])
    low, high = np.clip(mean + widened(found.size, confidence) * (ends - mean), *within)
    return SessionMean(mean, float(low), float(high), found.size)


def share_interval(
    right: Sequence[Sequence[bool] | NDArray[np.bool_]], rng: np.random.Generator
) -> SessionMean:
    """Return the mean share of right answers over sessions with its 95 % interval.

    Where all sessions agree, as at 100 %, they do not show their spread: the interval is then Wilson's
    over all trials, which is the least it can be.
    """
    if not all(len(one) for one in right):
        raise PerceptionError("a share of right answers needs a trial in every session")
    found = cluster_bootstrap([float(np.mean(one)) for one in right], rng, within=(0.0, 1.0))
    if found.low < found.high:
        return found
    least = wilson(sum(int(np.sum(one)) for one in right), sum(len(one) for one in right))
    return SessionMean(found.value, least.low, least.high, found.session_count)


def calibration_interval(
    groups: Sequence[tuple[Float64Array, NDArray[np.bool_]]],
    rng: np.random.Generator,
    *,
    bin_count: int = 10,
    resamples: int = 1000,
) -> tuple[float, float]:
    """Return the 95 % interval of the expected calibration error over groups of trials, as sessions.

    A mean of absolute values lies above the truth where that is near 0, and its resamples lie higher still,
    so their lower percentile is no bound: the interval is as wide downwards as it is upwards. A test shows
    that it holds the truth as often as it says.
    """
    count, trials = len(groups), sum(stated.size for stated, _ in groups)
    gaps = np.zeros((count, bin_count))
    for row, (confidence, right) in zip(gaps, groups, strict=True):
        stated = np.clip(confidence, 0.0, 1.0)
        row += np.bincount(reliability_bins(stated, bin_count), weights=stated - right, minlength=bin_count)
    error = float(np.abs(gaps.sum(axis=0)).sum() / trials)
    if count < 2:
        return error, error
    drawn = np.array([gaps[which].sum(axis=0) for which in rng.integers(0, count, (resamples, count))])
    high = float(np.quantile(np.abs(drawn).sum(axis=1) / trials, 0.975))
    half = widened(count) * max(high - error, 0.0)
    return max(error - half, 0.0), min(error + half, 1.0)


def sign_flip(differences: Sequence[float] | Float64Array, rng: np.random.Generator) -> float:
    """Return the two-sided p-value that a paired difference is symmetric about 0.

    The mean against its values when the sign of every session's difference is flipped: all patterns up to 14
    sessions, else 20,000 random ones and the one seen (Phipson and Smyth, 2010).
    """
    found = np.asarray(differences, dtype=np.float64)
    if found.size == 0 or found.ndim != 1 or not np.isfinite(found).all():
        raise PerceptionError("a paired comparison needs one finite difference a session, and a session")
    if found.size == 1:
        return 1.0  # SciPy takes no single one
    test = scipy.stats.permutation_test(
        (found,), np.mean, permutation_type="samples", n_resamples=20_000, rng=rng
    )
    return float(test.pvalue)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values adjusted for their family by Holm's step-down rule, in the order given."""
    if not all(0.0 <= p <= 1.0 for p in p_values):
        raise PerceptionError(f"Holm's rule is of p-values between 0 and 1, not {list(p_values)}")
    order = np.argsort(p_values, kind="stable")
    adjusted, reached = [0.0] * len(p_values), 0.0
    for rank, place in enumerate(order.tolist()):
        reached = max(reached, min(1.0, (len(p_values) - rank) * p_values[place]))
        adjusted[place] = reached
    return adjusted


def compare(
    sessions: Mapping[str, Sequence[float] | Float64Array],
    pairs: Sequence[tuple[str, str]],
    rng: np.random.Generator,
) -> list[PairedDifference]:
    """Compare methods on common sessions: differences with intervals, Holm over the pairs."""
    found = []
    for first, second in pairs:
        missing = [name for name in (first, second) if name not in sessions]
        if missing or len(sessions[first]) != len(sessions[second]):
            raise PerceptionError(f"{first} and {second} were not both run on the same sessions {missing}")
        difference = np.asarray(sessions[first], dtype=np.float64) - np.asarray(sessions[second])
        found.append((first, second, cluster_bootstrap(difference, rng), sign_flip(difference, rng)))
    adjusted = holm([p for *_, p in found])
    return [PairedDifference(a, b, d, p, q) for (a, b, d, p), q in zip(found, adjusted, strict=True)]
