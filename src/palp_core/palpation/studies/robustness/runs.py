"""Every policy in a cell, over its sessions, and how far each lies from the best of the others."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from palp_core.palpation.perception.belief.stopping import PaperVerbatim, PosteriorThreshold, StopRule
from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap
from palp_core.palpation.studies.robustness.cells import RobustnessCell
from palp_core.palpation.studies.simulation.policies import (
    FIXED,
    TrainedFeature,
    begin_trained,
    fixed_name,
    run_policy,
)
from palp_core.palpation.studies.simulation.policy_summary import accuracies, joined, summarise
from palp_core.palpation.studies.simulation.trials import Outcomes, run_trials
from palp_core.units import Float64Array

POLICIES = (
    *FIXED,
    "fixed_average",
    "fixed_best",
    "markov",
    "uniform",
    "uniform_stiff",
    "information_gain",
    "information_gain_latent",
    "reposition_best",
)
DESIGNS: dict[str, tuple[str, StopRule]] = {
    "paper": ("naive", PaperVerbatim()),
    "aware": ("latent", PosteriorThreshold()),
}
"""Filter and stop rule: the paper's; and the filter that knows what stays, with a threshold that can stop at
once."""


@dataclass(frozen=True)
class CellJob:
    """A cell over its sessions, under some designs."""

    cell: RobustnessCell
    designs: tuple[str, ...]
    seeds: tuple[tuple[int, ...], ...]


def run_cell(job: CellJob) -> list[dict[str, Any]]:
    """Return a record per design and policy.

    Accuracy, probes, seconds and calibration error (``ece``) with the ends ``_low`` and ``_high`` of their
    95 % intervals over sessions, and what :func:`to_best` returns.
    """
    records = []
    for design in job.designs:
        sessions = _sessions(job, design)
        sessions["fixed_average"] = joined({name: sessions[name] for name in FIXED})
        shares = {name: accuracies(sessions[name]) for name in POLICIES}
        for name in POLICIES:
            numbers = _numbers(sessions[name], job.cell.plan.gel.depths_m)
            records.append({"design": design, "policy": name, **numbers, **to_best(shares, name)})
    return records


def _numbers(sessions: Sequence[Outcomes], depths_m: Sequence[float]) -> dict[str, float]:
    line = summarise(sessions, depths_m)
    ends = {"accuracy": line["ci"], "ece": line["ece_ci"]}
    for key in ("probes", "seconds"):
        means = [float(getattr(one, key).mean()) for one in sessions]
        found = cluster_bootstrap(means, np.random.default_rng(18), within=(0.0, np.inf))
        ends[key] = [found.low, found.high]
    return {
        name: value
        for key in ("accuracy", "probes", "seconds", "ece")
        for name, value in zip((key, f"{key}_low", f"{key}_high"), (line[key], *ends[key]), strict=True)
    }


def to_best(shares: Mapping[str, Float64Array], policy: str) -> dict[str, Any]:
    """Compare a policy with the best of the others, session by session.

    The best of the others is chosen for each session by all the other sessions: the largest of a dozen noisy
    means is otherwise too large.

    Args:
        shares: Accuracy of each session by policy, shape (s,) each.
        policy: Which.

    Returns:
        ``best``, the other with the highest mean; ``lead`` over the best, with its ends
        ``lead_low`` and ``lead_high``.
    """
    others = [name for name in POLICIES if name != policy]
    table = np.array([shares[name] for name in others])
    count = table.shape[1]
    without = (table.sum(axis=1, keepdims=True) - table) / (count - 1) if count > 1 else table
    unseen_best = table[np.argmax(without, axis=0), np.arange(count)]
    lead = cluster_bootstrap(shares[policy] - unseen_best, np.random.default_rng(17), within=(-1.0, 1.0))
    best = others[int(np.argmax(table.mean(axis=1)))]
    return {"best": best, "lead": lead.value, "lead_low": lead.low, "lead_high": lead.high}


def _sessions(job: CellJob, design: str) -> dict[str, list[Outcomes]]:
    """Return the outcomes of every policy but ``fixed_average``, a session each."""
    every: dict[str, list[Outcomes]] = {name: [] for name in POLICIES if name != "fixed_average"}
    for seed in job.seeds:
        trained = begin_trained(job.cell.plan, seed)
        for name, kept in every.items():
            kept.append(_run(name, job.cell, trained, design, every))
    return every


def _run(
    name: str,
    cell: RobustnessCell,
    trained: TrainedFeature,
    design: str,
    done: Mapping[str, Sequence[Outcomes]],
) -> Outcomes:
    filter_name, stop = DESIGNS[design]
    if name == "fixed_best":  # it met the same luck as the position it is
        return done[fixed_name(trained.best_ring_m)][-1]
    if name == "markov":
        model = trained.naive if filter_name == "naive" else trained.latent
        return run_trials(trained.trials, model, cell.markov(), stop)
    return run_policy(name, trained, stop, filter_name=filter_name)
