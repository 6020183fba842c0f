"""The paper's words about its results, each beside what our trials say of it: as it is, whichever way."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from palp_core.palpation.perception.statistics.resampling import SessionMean, cluster_bootstrap
from palp_core.palpation.studies.paper.tests import FIXED_DEPTH_AND_RING, THREE_EXPERIMENTS
from palp_core.palpation.studies.simulation.policy_summary import depth_key
from palp_core.palpation.studies.simulation.trials import Outcomes

_SOON = 5  # iterations within which most of the paper's trials ended


def iterations(sessions: Sequence[Outcomes], depths_m: Sequence[float]) -> dict[str, Any]:
    """Return the iterations that trials took, by depth, with 95 % intervals over sessions.

    Args:
        sessions: Outcomes of the human strategy, a session each.
        depths_m: Depth of each class, increasing.

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


def beside_ours(took: Mapping[str, Any], analyses: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return statements of the paper, what ours say, and whether they agree.

    Args:
        took: As of :func:`iterations`.
        analyses: As of :func:`palp_core.palpation.studies.paper.tests.analyses`; their post hoc tests are of
            one session, as the paper's were.
    """
    means = [one["value"] for one in took["by_depth"].values()]
    grows = bool(np.all(np.diff(means) > 0.0)) and took["deepest_minus_shallowest"]["ci"][0] > 0.0
    low, high = took["deepest_minus_shallowest"]["ci"]
    found = [
        _said(
            "human strategy: the deeper the nodule, the more iterations",
            f"{', '.join(f'{mean:.2f}' for mean in means)} at {', '.join(took['by_depth'])} mm; deepest "
            f"minus shallowest {took['deepest_minus_shallowest']['value']:+.2f} ({low:+.2f} to {high:+.2f})",
            grows,
        ),
        _said(
            "human strategy: most trials end within five iterations",
            f"{100.0 * took['within_5']:.1f} % do",
            took["within_5"] > 0.5,
        ),
    ]
    for name in (FIXED_DEPTH_AND_RING, THREE_EXPERIMENTS):
        pairs = analyses[name]["bonferroni"].get("depth", [])
        found += [_alike(name, pair) for pair in pairs if {pair["first"], pair["second"]} == {"4", "8"}]
        found += [_best(name, pairs)] if pairs else []
    return found


def _alike(name: str, pair: Mapping[str, Any]) -> dict[str, Any]:
    p = pair["p_bonferroni"]
    if p is None:
        return _said(f"{name}: 4 and 8 mm do not differ (post hoc)", f"not testable: {pair['reason']}", None)
    gap = f"{pair['first']} minus {pair['second']} mm {100.0 * pair['difference']:+.1f} points, p {p:.2g}"
    return _said(f"{name}: 4 and 8 mm do not differ (post hoc)", gap, p >= 0.05)


def _best(name: str, pairs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return whether 2 mm is better than each other depth, of pairs whose first is the lesser in writing."""
    against = [pair for pair in pairs if pair["first"] == "2"]
    gaps = ", ".join(
        f"2 minus {pair['second']} mm {100.0 * pair['difference']:+.1f} points" for pair in against
    )
    sure = [pair["p_bonferroni"] is not None and pair["p_bonferroni"] < 0.05 for pair in against]
    better = all(sure) and all(pair["difference"] > 0.0 for pair in against)
    return _said(f"{name}: 2 mm is more accurate than the rest (post hoc)", gaps, better)


def _said(paper: str, ours: str, agrees: bool | None) -> dict[str, Any]:
    return {"paper": paper, "ours": ours, "agrees": agrees}
