"""The paper's tests on our trials: its analyses of variance, and the comparisons it did not make."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from palp_core.palpation.perception.statistics.anova import (
    NotTestable,
    bonferroni,
    mixed_logit,
    permutation,
    two_way,
)
from palp_core.palpation.perception.statistics.resampling import SessionMean, cluster_bootstrap, compare
from palp_core.palpation.studies.paper.numbers import HUMAN_OF, HUMAN_RIGHT
from palp_core.palpation.studies.simulation.policies import FIXED
from palp_core.palpation.studies.simulation.policy_summary import accuracies, depth_key, joined
from palp_core.palpation.studies.simulation.trials import Outcomes

Sessions = Mapping[str, Sequence[Outcomes]]

FIXED_DEPTH_AND_RING = "fixed: depth and r_a"
THREE_EXPERIMENTS = "human, fixed and human strategy: depth and experiment"
_BEST = "best fixed position and human strategy: depth and experiment"

REPORTED = {
    FIXED_DEPTH_AND_RING: "depth, r_a and their interaction significant (p < 0.05); post hoc 2 mm "
    "better than the rest, and r_a in three groups",
    THREE_EXPERIMENTS: "depth and experiment significant, their interaction not; post hoc 2 mm best, "
    "4 and 8 mm alike; human against fixed no difference, varied better than fixed",
    _BEST: "no such analysis: its fixed stiffness is the average over five positions",
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
            "ci": [one.difference.low, one.difference.high],
            "p": one.p,
            "p_holm": one.p_holm,
        }
        for one in compare(table, PAIRS, np.random.default_rng(12))
    ]


def analyses(sessions: Sessions, depths_m: Sequence[float]) -> dict[str, Any]:
    """Return the paper's two analyses of variance on our trials, and a third, and what to trust instead.

    One session is what the paper had; its table is that of the first session. The human's trials are those of
    the published counts. The mixed logit and the permutation test are over all sessions, and our trials only.
    """
    fixed = {name: sessions[name] for name in FIXED}
    human = _published_human(depths_m)
    average = {"fixed": joined(fixed), "human strategy": sessions["markov"]}
    best = {"fixed_best": sessions["fixed_best"], "markov": sessions["markov"]}
    return {
        FIXED_DEPTH_AND_RING: {"paper": REPORTED[FIXED_DEPTH_AND_RING]} | _one(fixed, "r_a", depths_m),
        THREE_EXPERIMENTS: {"paper": REPORTED[THREE_EXPERIMENTS]}
        | _one(average, "experiment", depths_m, human),
        _BEST: {"paper": REPORTED[_BEST]} | _one(best, "experiment", depths_m),
    }


_SOON = 5  # iterations within which most of the paper's trials ended

Columns = tuple[list[float], list[str], list[str]]


def _published_human(depths_m: Sequence[float]) -> Columns:
    """Return outcome, depth and experiment of the human's trials, from the published percentages."""
    keys = [key for key in map(depth_key, depths_m) if key in HUMAN_RIGHT]
    right = [float(n < HUMAN_RIGHT[key]) for key in keys for n in range(HUMAN_OF)]
    return right, [key for key in keys for _ in range(HUMAN_OF)], ["human"] * len(right)


def _one(
    sessions: Sessions, factor: str, depths_m: Sequence[float], more: Columns = ([], [], [])
) -> dict[str, Any]:
    first = {name: found[:1] for name, found in sessions.items()}
    right, depth, kind, _ = _columns(first, depths_m)
    right, depth, kind = right + more[0], depth + more[1], kind + more[2]
    table = two_way(right, depth, kind, names=("depth", factor))
    post = (
        {}
        if isinstance(table, NotTestable)
        else {
            "depth": [asdict(t) for t in bonferroni(right, depth)],
            factor: [asdict(t) for t in bonferroni(right, kind)],
        }
    )
    right, depth, kind, session = _columns(sessions, depths_m)
    logit = mixed_logit(right, {"depth": depth, factor: kind}, session)
    exchanged = permutation(right, kind, session, np.random.default_rng(13), shuffles=500)
    return {
        "as_in_the_paper": asdict(table),
        "bonferroni": post,
        "mixed_logit": asdict(logit) if isinstance(logit, NotTestable) else [asdict(e) for e in logit],
        f"permutation_{factor}": asdict(exchanged) if isinstance(exchanged, NotTestable) else exchanged,
    }


def _columns(
    sessions: Sessions, depths_m: Sequence[float]
) -> tuple[list[float], list[str], list[str], list[int]]:
    """Return outcome, depth, policy and session of every trial."""
    right: list[float] = []
    depth: list[str] = []
    kind: list[str] = []
    session: list[int] = []
    for name, found in sessions.items():
        for number, one in enumerate(found):
            right += one.correct.astype(float).tolist()
            depth += [depth_key(depths_m[c]) for c in one.depth.tolist()]
            kind += [name] * len(one.depth)
            session += [number] * len(one.depth)
    return right, depth, kind, session


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
            depth_key(depth_m): _ends(cluster_bootstrap(column, rng, within=(0.0, np.inf)))
            for depth_m, column in zip(depths_m, means.T, strict=True)
        },
        "deepest_minus_shallowest": _ends(cluster_bootstrap(means[:, -1] - means[:, 0], rng)),
        "within_5": float(np.mean(every <= _SOON)),
    }


def _ends(of: SessionMean) -> dict[str, Any]:
    return {"value": of.value, "ci": [of.low, of.high]}
