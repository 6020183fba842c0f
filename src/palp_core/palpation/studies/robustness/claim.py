"""Is information gain ever significantly worse than the best of the others, and what makes it so?

The best of the others is chosen for each session by all the other sessions, so that the one it is compared in
does not choose it: the largest of a dozen noisy means is otherwise too large. A family of comparisons is one
policy and design over all cells (Holm).

Where information gain is worse, the cell is run again with one thing changed, for all policies alike: the
reason is what, changed alone, takes the deficit away.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from palp_core.palpation.perception.belief.stopping import FixedNumber
from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap, holm, sign_flip
from palp_core.palpation.studies.robustness.jobs import DESIGNS, POLICIES, FilterDesign
from palp_core.units import Float64Array

CLAIMS = (
    ("information_gain", "paper"),
    ("information_gain_latent", "paper"),
    ("information_gain_latent", "aware"),
)
"""Policy and design; the first is the paper's filter throughout."""

LEVEL = 0.05
_ALL_BITS = float(np.log2(3.0))
_SATURATED = 0.02  # bits below what three depths hold
_PROBES = 6
_TRAINING = 2000


@dataclass(frozen=True)
class Change:
    """One thing changed, and what it says if the deficit goes with it.

    Attributes:
        name: As in tables.
        reason: What the cause then is.
        designs: The design to run instead, by the one that was run; a claim of another design has no such
            change.
    """

    name: str
    reason: str
    designs: Mapping[str, FilterDesign]


_PAPER, _AWARE = DESIGNS["paper"], DESIGNS["aware"]

CHANGES = (
    Change(
        f"{_PROBES} probes for all",
        "the stop rule: it takes fewer probes than the others",
        {
            "paper": FilterDesign("naive", FixedNumber(_PROBES)),
            "aware": FilterDesign("latent", FixedNumber(_PROBES)),
        },
    ),
    Change(
        "the policy is told what stays",
        "the policy's promise: it takes readings for independent, so a new landing of the ring, and a second "
        "ring position, look worth no more than the same reading again",
        {"paper": FilterDesign("naive", _PAPER.stop, promise=True)},
    ),
    Change(
        "the filter is told what stays",
        "the filter: it takes readings that share an error for independent, and weighs them wrongly",
        {"paper": FilterDesign("latent", _PAPER.stop)},
    ),
    Change(
        "policy and filter are told",
        "policy and filter together: neither knows what stays",
        {"paper": FilterDesign("latent", _PAPER.stop, promise=True)},
    ),
    Change(
        f"{_TRAINING} training palpations",
        "training: too few palpations to know what each ring position is worth",
        {
            "paper": FilterDesign("naive", _PAPER.stop, training=_TRAINING),
            "aware": FilterDesign("latent", _AWARE.stop, training=_TRAINING),
        },
    ),
)


def changes_of(policy: str, design: str) -> list[Change]:
    """Return the changes that are changes for a claim."""
    return [
        one
        for one in CHANGES
        if design in one.designs and not (policy == "information_gain_latent" and _only_promise(one))
    ]


def _only_promise(change: Change) -> bool:
    return all(design.promise for design in change.designs.values())


def against_best(lines: Mapping[str, Mapping[str, Any]], policy: str) -> dict[str, Any]:
    """Compare a policy with the best of the others, session by session.

    Args:
        lines: ``per_session`` accuracies (and more) by policy.
        policy: Which.

    Returns:
        ``best``, the other with the highest mean; ``difference`` with ``ci`` and sign-flip ``p``, where in
        each session the best is that of all the others; and ``probes``, how many it takes less than the best.
    """
    best, difference = _paired(lines, policy)
    rng = np.random.default_rng(17)
    interval = cluster_bootstrap(difference, rng, within=(-1.0, 1.0))
    return {
        "best": best,
        "difference": interval.value,
        "ci": [interval.low, interval.high],
        "p": sign_flip(difference, rng),
        "fewer_probes": lines[best]["probes"] - lines[policy]["probes"],
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


def reasons(
    row: Mapping[str, Any], changed: Sequence[Mapping[str, Any]], promised: Mapping[str, Mapping[str, float]]
) -> list[str]:
    """Return why information gain is worse in a cell.

    Args:
        row: Its comparison with the best of the others.
        changed: The same comparison, with one thing changed each.
        promised: What it is promised by each ring position, as of
            :func:`~palp_core.palpation.studies.robustness.jobs.promises`.
    """
    by_name = {one.name: one for one in CHANGES}
    found = [
        f"{by_name[one['change']].reason} ({_points(one)} instead of {_points(row)})"
        for one in changed
        if one["ci"][1] >= 0.0 and one["difference"] > 0.5 * row["difference"]
    ]
    full = [ring for ring, one in promised.items() if one["bits"] > _ALL_BITS - _SATURATED]
    if len(full) > 1:
        found.append(
            f"its promise is full: by its model one reading tells all {_ALL_BITS:.2f} bits at "
            f"{', '.join(full)} mm alike, so it does not see which position errs least"
        )
    return found or [
        "none of the changes alone takes it away: what is left is that it looks one probe ahead, and takes "
        "readings to answer in straight lines to landing and height"
    ]


def _points(row: Mapping[str, Any]) -> str:
    return f"{100 * row['difference']:+.1f} points, {100 * row['ci'][0]:+.1f} to {100 * row['ci'][1]:+.1f}"
