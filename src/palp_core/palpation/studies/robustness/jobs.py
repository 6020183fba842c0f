"""The work of the study ``robustness``: every policy in a cell, over its sessions, under a design."""

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
from palp_core.palpation.studies.simulation.policy_summary import joined, summarise
from palp_core.palpation.studies.simulation.session import WorldPlan
from palp_core.palpation.studies.simulation.trials import Outcomes, run_trials

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


@dataclass(frozen=True)
class FilterDesign:
    """How trials are decided.

    Attributes:
        filter_name: ``naive`` or ``latent``.
        stop: The stop rule.
    """

    filter_name: str
    stop: StopRule


DESIGNS = {
    "paper": FilterDesign("naive", PaperVerbatim()),
    "aware": FilterDesign("latent", PosteriorThreshold()),
}
"""The paper's filter and stop rule; and the filter that knows what stays, with a threshold that can stop at
once."""


@dataclass(frozen=True)
class CellJob:
    """A cell over its sessions, under some designs."""

    cell: RobustnessCell
    designs: tuple[tuple[str, FilterDesign], ...]
    seeds: tuple[tuple[int, ...], ...]


def run_cell(job: CellJob) -> dict[str, dict[str, Any]]:
    """Return, by design and policy, the numbers of :func:`.summarise`.

    With 95 % intervals over sessions as ``accuracy_ci``, ``probes_ci``, ``seconds_ci`` and ``ece_ci``.
    """
    lines = {}
    for name, design in job.designs:
        sessions = dict(sessions_of(job.cell, design, job.seeds))
        sessions["fixed_average"] = joined({one: sessions[one] for one in FIXED})
        lines[name] = {one: _line(sessions[one], job.cell.gel.depths_m) for one in POLICIES}
    return lines


def _line(sessions: Sequence[Outcomes], depths_m: Sequence[float]) -> dict[str, Any]:
    line = summarise(sessions, depths_m)
    line["accuracy_ci"] = line.pop("ci")
    for key in ("probes", "seconds"):
        found = cluster_bootstrap(
            [float(getattr(one, key).mean()) for one in sessions],
            np.random.default_rng(18),
            within=(0.0, np.inf),
        )
        line[f"{key}_ci"] = [found.low, found.high]
    return line


def sessions_of(
    cell: RobustnessCell, design: FilterDesign, seeds: Sequence[tuple[int, ...]]
) -> Mapping[str, Sequence[Outcomes]]:
    """Return the outcomes of every policy, a session each; ``fixed_average`` is not one."""
    every: dict[str, list[Outcomes]] = {name: [] for name in POLICIES if name != "fixed_average"}
    for seed in seeds:
        trained = begin_trained(WorldPlan(gel=cell.gel, conditions=cell.conditions), seed)
        for name, kept in every.items():
            kept.append(_run(name, cell, trained, design, every))
    return every


def _run(
    name: str,
    cell: RobustnessCell,
    trained: TrainedFeature,
    design: FilterDesign,
    done: Mapping[str, Sequence[Outcomes]],
) -> Outcomes:
    if name == "fixed_best":  # it met the same luck as the position it is
        return done[fixed_name(trained.best_ring_m)][-1]
    if name == "markov":
        model = trained.naive if design.filter_name == "naive" else trained.latent
        return run_trials(trained.trials, model, cell.markov(), design.stop)
    return run_policy(name, trained, design.stop, filter_name=design.filter_name)
