"""Is information gain ever significantly worse than the best of the others?

The best of the others is chosen for each session by all the other sessions, so that the one it is compared in
does not choose it: the largest of a dozen noisy means is otherwise too large. A family of comparisons is one
policy and design over all cells (Holm).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap, holm, sign_flip
from palp_core.palpation.studies.robustness.jobs import POLICIES
from palp_core.units import Float64Array

CLAIMS = (
    ("information_gain", "paper"),
    ("information_gain_latent", "paper"),
    ("information_gain_latent", "aware"),
)
"""Policy and design; the first is the paper's filter throughout."""

LEVEL = 0.05


def against_best(lines: Mapping[str, Mapping[str, Any]], policy: str) -> dict[str, Any]:
    """Compare a policy with the best of the others, session by session.

    Args:
        lines: ``per_session`` accuracies (and more) by policy.
        policy: Which.

    Returns:
        ``best``, the other with the highest mean; ``difference`` with ``ci`` and sign-flip ``p``, where in
        each session the best is that of all the others.
    """
    best, difference = _paired(lines, policy)
    rng = np.random.default_rng(17)
    interval = cluster_bootstrap(difference, rng, within=(-1.0, 1.0))
    return {
        "best": best,
        "difference": interval.value,
        "ci": [interval.low, interval.high],
        "p": sign_flip(difference, rng),
    }


def to_best(lines: Mapping[str, Mapping[str, Any]], policy: str) -> dict[str, Any]:
    """Return ``difference`` and ``ci`` as of :func:`against_best`, without its test."""
    _, difference = _paired(lines, policy)
    interval = cluster_bootstrap(difference, np.random.default_rng(17), within=(-1.0, 1.0))
    return {"difference": interval.value, "ci": [interval.low, interval.high]}


def _paired(lines: Mapping[str, Mapping[str, Any]], policy: str) -> tuple[str, Float64Array]:
    """Return the other with the highest mean, and the lead over the unseen best in each session, (s,)."""
    others = [name for name in POLICIES if name != policy]
    shares = np.array([lines[name]["per_session"] for name in others])
    own = np.array(lines[policy]["per_session"])
    return others[int(np.argmax(shares.mean(axis=1)))], own - _unseen_best(shares)


def _unseen_best(shares: Float64Array) -> Float64Array:
    """Return each session's share of the policy that is best in all other sessions, shape (s,)."""
    count = shares.shape[1]
    if count == 1:
        return np.asarray(shares.max(axis=0))
    without = (shares.sum(axis=1, keepdims=True) - shares) / (count - 1)
    return np.asarray(shares[np.argmax(without, axis=0), np.arange(count)])


def judged(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return comparisons of one claim with Holm's p.

    Args:
        rows: Of :func:`against_best`, one per cell.

    Returns:
        They, with ``worse``: significantly, within the family; and ``suspected``: its own interval, taken
        alone, is below 0 (of 40 such intervals, one lies there by chance).
    """
    return [
        {
            **row,
            "p_holm": p,
            "worse": bool(p < LEVEL and row["difference"] < 0.0),
            "suspected": bool(row["ci"][1] < 0.0),
        }
        for row, p in zip(rows, holm([row["p"] for row in rows]), strict=True)
    ]
