"""How many sessions a comparison takes: trials of a session share its training and its mountings."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from statsmodels.stats.power import normal_power, ttest_power  # type: ignore[import-untyped]

from palp_core.palpation.studies.paper.numbers import PUBLISHED
from palp_core.palpation.studies.simulation.policies import FIXED
from palp_core.palpation.studies.simulation.trials import Outcomes
from palp_core.units import Float64Array

COMPARISONS = (
    ("markov", "fixed_average"),
    ("markov", "uniform"),
    ("markov", "fixed_best"),
    ("information_gain_latent", "fixed_best"),
)
TRIALS = (1, 5, 20, 100)
"""Of a depth and session."""
_LEVEL, _MOST_SESSIONS, _PUBLISHED_TRIALS = 0.05, 120, 300


def power_report(sessions: Mapping[str, Sequence[Outcomes]], class_count: int) -> dict[str, Any]:
    """Return how alike trials of a session are, and how many sessions differences need."""
    shares = {
        name: np.array(
            [[one.correct[one.depth == c].mean() for c in range(class_count)] for one in sessions[name]]
        )
        for name in (*FIXED, "fixed_best", "markov", "uniform", "information_gain_latent")
    }
    shares["fixed_average"] = np.mean([shares[name] for name in FIXED], axis=0)
    trials = sessions["markov"][0].correct.size
    policies = {}
    for name in dict.fromkeys(name for pair in COMPARISONS for name in pair):
        right = shares[name].mean(axis=1)
        alike = correlate_trials(right, trials)
        policies[name] = {
            "session_sd": float(right.std(ddof=1)),
            "intraclass": alike,
            "worth_of_300": _PUBLISHED_TRIALS / (1.0 + (_PUBLISHED_TRIALS - 1) * alike),
        }
    base = PUBLISHED["fixed"]["overall"]
    return {
        "policies": policies,
        "needed": [
            {
                "first": first,
                "second": second,
                "trials": count,
                **{str(w): count_sessions(shares[first], shares[second], count, w / 100) for w in (80, 90)},
            }
            for first, second in COMPARISONS
            for count in TRIALS
        ],
        "least_share": {
            "independent": least_share(base, 0.0),
            "of one session": least_share(base, policies["fixed_average"]["intraclass"]),
        },
    }


def correlate_trials(right: Float64Array, trials: int) -> float:
    """Return the intraclass correlation of sessions of equal length, by one-way analysis of variance.

    Args:
        right: Share of right answers of each session, shape (s,).
        trials: Of each session.
    """
    between = trials * float(right.var(ddof=1))
    within = float(np.mean(right * (1.0 - right))) * trials / (trials - 1)
    total = between + (trials - 1) * within
    return max(0.0, (between - within) / total) if total > 0.0 else 0.0


def count_sessions(first: Float64Array, second: Float64Array, trials: int, wanted: float) -> int | None:
    """Return the least sessions with which Student's paired test has a power; None: more than 120.

    Args:
        first: Share of right answers of one way in each session and depth, shape (s, m).
        second: Of the other, likewise.
        trials: Of each way, session and depth.
        wanted: Power, two-sided at a level of 0.05.
    """
    apart = (first - second).mean(axis=1)
    own = (first * (1.0 - first) + second * (1.0 - second)).sum(axis=1).mean()
    spread = float(np.sqrt(apart.var(ddof=1) + own / (trials * first.shape[1] ** 2)))
    if spread == 0.0:
        return 2 if apart.mean() != 0.0 else None
    effect = abs(float(apart.mean())) / spread
    for count in range(2, _MOST_SESSIONS + 1):
        power = float(ttest_power(effect, count, _LEVEL))
        # far out the noncentral t has no number; the normal law is as good there
        if (power if np.isfinite(power) else float(normal_power(effect, count, _LEVEL))) >= wanted:
            return count
    return None


def least_share(base: float, correlation: float, wanted: float = 0.8) -> float | None:
    """Return the least share that 300 trials of each way resolve from ``base``; None: not even 1."""
    effect = 1.0 + (_PUBLISHED_TRIALS - 1) * correlation
    for share in np.arange(base, 1.0 + 1e-9, 0.001):
        variance = (base * (1.0 - base) + share * (1.0 - share)) * effect / _PUBLISHED_TRIALS
        if normal_power(share - base, 1, _LEVEL, sigma=np.sqrt(variance)) >= wanted:
            return float(share)
    return None
