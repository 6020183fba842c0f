"""The paper's tests on our trials, the comparisons it did not make, and how many sessions these take."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from statsmodels.stats.power import normal_power, ttest_power  # type: ignore[import-untyped]

from palp_core.palpation.perception.statistics.anova import (
    NotTestable,
    bonferroni,
    two_way,
)
from palp_core.palpation.perception.statistics.resampling import SessionMean, cluster_bootstrap, compare
from palp_core.palpation.studies.paper.numbers import HUMAN_OF, HUMAN_RIGHT
from palp_core.palpation.studies.schemes import FIXED
from palp_core.palpation.studies.summary import accuracies, depth_key, ends, joined
from palp_core.palpation.studies.trials import Outcomes
from palp_core.units import Float64Array

Sessions = Mapping[str, Sequence[Outcomes]]
_Trial = tuple[float, str, str]
"""Outcome, depth and policy of a trial."""

REPORTED = {
    "fixed: depth and r_a": "depth, r_a and their interaction significant (p < 0.05); post hoc 2 mm "
    "better than the rest, and r_a in three groups",
    "human, fixed and human strategy: depth and experiment": "depth and experiment significant, their "
    "interaction not; post hoc 2 mm best, 4 and 8 mm alike; human against fixed no difference, varied better "
    "than fixed",
    "best fixed position and human strategy: depth and experiment": "no such analysis: its fixed stiffness "
    "is the average over five positions",
}
"""What the paper says of each analysis."""

PAIRS = (
    ("markov", "fixed_average"),
    ("markov", "fixed_best"),
    ("markov", "markov_stationary"),
    ("markov", "markov_reversed"),
    ("markov", "markov_permuted"),
    ("markov", "uniform"),
    ("markov", "uniform_stiff"),
    ("information_gain", "fixed_best"),
    ("information_gain_latent", "fixed_best"),
    ("information_gain_latent", "information_gain"),
    ("reposition_best", "fixed_best"),
)


def comparisons(sessions: Sessions, average: Sequence[float]) -> list[dict[str, Any]]:
    """Return paired differences of accuracy, Holm over the family."""
    table = {name: accuracies(found) for name, found in sessions.items()} | {
        "fixed_average": np.asarray(average)
    }
    return [
        {
            "first": one.first,
            "second": one.second,
            "difference": one.difference.value,
            "ci": ends(one.difference),
            "p": one.p,
            "p_holm": one.p_holm,
        }
        for one in compare(table, PAIRS, np.random.default_rng(12))
    ]


def analyses(sessions: Sessions, depths_m: Sequence[float]) -> dict[str, Any]:
    """Return the paper's two analyses of variance on our trials, and a third.

    One session is what the paper had; its table is that of the first session. The human's trials are those of
    the published counts.
    """
    fixed = {name: sessions[name] for name in FIXED}
    average = {"fixed": joined(fixed), "human strategy": sessions["markov"]}
    best = {"fixed_best": sessions["fixed_best"], "markov": sessions["markov"]}
    asked: tuple[tuple[Sessions, str, list[_Trial]], ...] = (
        (fixed, "r_a", []),
        (average, "experiment", _published(depths_m)),
        (best, "experiment", []),
    )
    return {
        name: {"paper": reported} | _analyse(trials, factor, depths_m, human)
        for (name, reported), (trials, factor, human) in zip(REPORTED.items(), asked, strict=True)
    }


def _trials(sessions: Sessions, depths_m: Sequence[float]) -> list[_Trial]:
    """Return the trials of sessions of several policies."""
    return [
        (float(right), depth_key(depths_m[c]), name)
        for name, found in sessions.items()
        for one in found
        for right, c in zip(one.correct.tolist(), one.depth.tolist(), strict=True)
    ]


def _published(depths_m: Sequence[float]) -> list[_Trial]:
    """Return the human's trials, from the published percentages."""
    return [
        (float(n < HUMAN_RIGHT[key]), key, "human")
        for key in map(depth_key, depths_m)
        if key in HUMAN_RIGHT
        for n in range(HUMAN_OF)
    ]


def _analyse(
    sessions: Sessions, factor: str, depths_m: Sequence[float], human: list[_Trial]
) -> dict[str, Any]:
    once = human + _trials({name: found[:1] for name, found in sessions.items()}, depths_m)
    right, depth, kind = zip(*once, strict=True)
    table = two_way(right, depth, kind, names=("depth", factor))
    groups = {} if isinstance(table, NotTestable) else {"depth": depth, factor: kind}
    return {
        "as_in_the_paper": asdict(table),
        "bonferroni": {
            name: [asdict(pair) for pair in bonferroni(right, group)] for name, group in groups.items()
        },
    }


_SOON = 5  # iterations within which most of the paper's trials ended


def iterations(sessions: Sequence[Outcomes], depths_m: Sequence[float]) -> dict[str, Any]:
    """Return the iterations that trials took, by depth, with 95 % intervals over sessions.

    Returns:
        ``by_depth`` in mm: ``value`` and ``ci``; ``deepest_minus_shallowest``, likewise, within sessions;
        ``within_5``, the share of trials that took five or fewer.
    """
    rng = np.random.default_rng(14)
    means = np.array([[one.probes[one.depth == c].mean() for c in range(len(depths_m))] for one in sessions])
    every = np.concatenate([one.probes for one in sessions])
    return {
        "by_depth": {
            depth_key(depth_m): _interval(cluster_bootstrap(column, rng, within=(0.0, np.inf)))
            for depth_m, column in zip(depths_m, means.T, strict=True)
        },
        "deepest_minus_shallowest": _interval(cluster_bootstrap(means[:, -1] - means[:, 0], rng)),
        "within_5": float(np.mean(every <= _SOON)),
    }


def _interval(of: SessionMean) -> dict[str, Any]:
    return {"value": of.value, "ci": ends(of)}


POWER_PAIRS = (
    ("markov", "fixed_average"),
    ("markov", "uniform"),
    ("markov", "fixed_best"),
    ("information_gain_latent", "fixed_best"),
)
_TRIALS = (1, 5, 20, 100)  # of a depth and session
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
    for name in dict.fromkeys(name for pair in POWER_PAIRS for name in pair):
        right = shares[name].mean(axis=1)
        alike = correlate_trials(right, trials)
        policies[name] = {
            "session_sd": float(right.std(ddof=1)),
            "intraclass": alike,
            "worth_of_300": _PUBLISHED_TRIALS / (1.0 + (_PUBLISHED_TRIALS - 1) * alike),
        }
    return {
        "policies": policies,
        "needed": [
            {
                "first": first,
                "second": second,
                "trials": count,
                **{str(w): count_sessions(shares[first], shares[second], count, w / 100) for w in (80, 90)},
            }
            for first, second in POWER_PAIRS
            for count in _TRIALS
        ],
    }


def correlate_trials(right: Float64Array, trials: int) -> float:
    """Return the intraclass correlation of sessions of equal length, by one-way analysis of variance."""
    between = trials * float(right.var(ddof=1))
    within = float(np.mean(right * (1.0 - right))) * trials / (trials - 1)
    total = between + (trials - 1) * within
    return max(0.0, (between - within) / total) if total > 0.0 else 0.0


def count_sessions(first: Float64Array, second: Float64Array, trials: int, wanted: float) -> int | None:
    """Return the least sessions with which Student's paired test has a power; None: more than 120."""
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
