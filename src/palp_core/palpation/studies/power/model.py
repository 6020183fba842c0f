"""Trials that share a session: intraclass correlation, design effect, power by formula and by simulation.

Sessions are clusters of trials. The formula is that of two proportions with a design effect (Donner and Klar,
"Design and Analysis of Cluster Randomization Trials in Health Research", 2000, ch. 5), or that of a paired
test over sessions; the simulation draws sessions and trials and tests them, and knows nothing of the formula.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats
from statsmodels.stats.power import normal_power, ttest_power  # type: ignore[import-untyped]

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.statistics.resampling import holm
from palp_core.units import Float64Array

_SPREAD = 1e-12  # sessions whose mean is known better than this all agree, but for rounding


@dataclass(frozen=True)
class Law:
    """Right answers of sessions of equal length.

    Attributes:
        share: Mean share of right answers.
        intraclass: Correlation of two trials of one session.
    """

    share: float
    intraclass: float


def intraclass(right: Float64Array, trials: int) -> Law:
    """Return the law of sessions, by one-way analysis of variance of right and wrong.

    Args:
        right: Share of right answers of each session, shape (s,).
        trials: Of each session.

    Returns:
        A correlation below 0 counts as 0.

    Raises:
        PerceptionError: There are fewer than two sessions or trials.
    """
    if right.size < 2 or trials < 2:
        raise PerceptionError("a correlation within sessions needs two sessions of two trials at least")
    share = float(right.mean())
    between = trials * float(right.var(ddof=1))
    within = float(np.mean(right * (1.0 - right))) * trials / (trials - 1)
    total = between + (trials - 1) * within
    return Law(share, max(0.0, (between - within) / total) if total > 0.0 else 0.0)


def design_effect(correlation: float, trials: int) -> float:
    """Return by how much sessions of so many trials widen a variance: 1 + (n - 1) rho.

    >>> design_effect(0.05, 21)
    2.0
    """
    return 1.0 + (trials - 1) * correlation


def formula_power(first: Law, second: Law, sessions: int, trials: int, *, level: float = 0.05) -> float:
    """Return the power to tell two arms of sessions of their own apart, two-sided, by the normal law.

    It takes the variances for known, so with few sessions it promises more than a test can keep.

    Args:
        first: One arm.
        second: The other.
        sessions: Of each arm.
        trials: Of each session.
        level: Of the test.
    """
    variance = sum(
        arm.share * (1.0 - arm.share) * design_effect(arm.intraclass, trials) / (sessions * trials)
        for arm in (first, second)
    )
    difference = abs(first.share - second.share)
    if variance == 0.0:
        return 1.0 if difference > 0.0 else level
    return float(normal_power(difference, 1, level, sigma=np.sqrt(variance)))


def paired_power(
    first: Float64Array, second: Float64Array, sessions: int, trials: int, *, level: float = 0.05
) -> float:
    """Return the power of Student's paired test over sessions in which both arms are run (noncentral t).

    Args:
        first: Shares of one arm in every session and stratum, shape (s, m).
        second: Of the other, likewise.
        sessions: Of the experiment; 2 at least.
        trials: Of each arm, session and stratum.
        level: Of the test.
    """
    apart = (first - second).mean(axis=1)
    own = (first * (1.0 - first) + second * (1.0 - second)).sum(axis=1).mean()
    variance = float(apart.var(ddof=1) + own / (trials * first.shape[1] ** 2))
    if variance == 0.0:
        return 1.0 if apart.mean() != 0.0 else level
    effect = abs(float(apart.mean())) / np.sqrt(variance)
    power = float(ttest_power(effect, sessions, level))
    # far out the noncentral t has no number; the normal law is as good there
    return power if np.isfinite(power) else float(normal_power(effect, sessions, level))


def detectable(
    base: float, correlation: float, sessions: int, trials: int, *, power: float = 0.8
) -> float | None:
    """Return the least share above ``base`` that two arms tell from it with this power; None: not even 1.

    Args:
        base: Share of the worse arm.
        correlation: Within sessions, of both arms.
        sessions: Of each arm.
        trials: Of each session.
        power: Wanted.
    """
    grid = np.arange(base, 1.0 + 1e-9, 0.001)
    for share in grid:
        better = Law(min(float(share), 1.0), correlation)
        if formula_power(Law(base, correlation), better, sessions, trials) >= power:
            return better.share
    return None


def beta_sessions(law: Law, shape: tuple[int, ...], rng: np.random.Generator) -> Float64Array:
    """Return the true shares of sessions: a beta law with this mean and correlation.

    Args:
        law: Of right answers.
        shape: Of the result.
        rng: Of the draws.
    """
    if law.intraclass <= 0.0 or law.share in (0.0, 1.0):
        return np.full(shape, law.share)
    size = 1.0 / law.intraclass - 1.0
    return np.asarray(rng.beta(law.share * size, (1.0 - law.share) * size, shape))


def paired_p(differences: Float64Array) -> Float64Array:
    """Return Student's two-sided p for the mean of paired differences, sessions along the last axis.

    A single session, or sessions that all agree to the last trial, test nothing: 1.
    """
    count = differences.shape[-1]
    p = np.ones(differences.shape[:-1])
    if count > 1:
        told = differences.std(axis=-1, ddof=1) / np.sqrt(count) >= _SPREAD
        p[told] = stats.ttest_1samp(differences[told], 0.0, axis=-1).pvalue
    return p


def unpaired_p(first: Float64Array, second: Float64Array) -> Float64Array:
    """Return Welch's two-sided p for two arms of sessions of their own, along the last axis.

    Arms of a single session, or whose sessions all agree, test nothing: 1.
    """
    p = np.ones(first.shape[:-1])
    counts = first.shape[-1], second.shape[-1]
    if min(counts) > 1:
        (m1, s1), (m2, s2) = ((arm.mean(axis=-1), arm.std(axis=-1, ddof=1)) for arm in (first, second))
        told = np.sqrt(s1**2 / counts[0] + s2**2 / counts[1]) >= _SPREAD
        p[told] = stats.ttest_ind_from_stats(
            m1[told], s1[told], counts[0], m2[told], s2[told], counts[1], equal_var=False
        ).pvalue
    return p


def pooled_p(first: Float64Array, second: Float64Array, trials: int) -> Float64Array:
    """Return the two-sided p of two proportions that takes all trials for independent.

    Args:
        first: Right answers of one arm, any shape.
        second: Of the other.
        trials: Of each arm.
    """
    pooled = (first + second) / (2.0 * trials)
    error = np.sqrt(2.0 * pooled * (1.0 - pooled) / trials)
    sure = error == 0.0
    z = np.where(sure, 0.0, (first - second) / trials / np.where(sure, 1.0, error))
    return np.asarray(2.0 * stats.norm.sf(np.abs(z)))


def holm_rows(p: Float64Array) -> Float64Array:
    """Return Holm's p-values of many families, shape (n, comparisons)."""
    return np.array([holm(row) for row in p.tolist()])


def least_sessions(counts: Sequence[int], powers: Sequence[float], wanted: float) -> int | None:
    """Return the least count from which on the power is enough; None where it never is.

    >>> least_sessions((2, 4, 8), (0.3, 0.85, 0.95), 0.8)
    4
    """
    enough = None
    for count, power in sorted(zip(counts, powers, strict=True), reverse=True):
        if power < wanted:
            break
        enough = count
    return enough
