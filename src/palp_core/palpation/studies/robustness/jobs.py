"""The work of the study ``robustness``: every policy in a cell, over its sessions, under a design."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.belief.stopping import PaperVerbatim, PosteriorThreshold, StopRule
from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap
from palp_core.palpation.perception.strategy.policies import MarkovPolicy
from palp_core.palpation.perception.strategy.policies_informed import InformationGainLatent
from palp_core.palpation.studies.robustness.cells import RobustnessCell
from palp_core.palpation.studies.simulation.policies import (
    FIXED,
    SimulatedSession,
    begin_session,
    fixed_name,
    run_policy,
)
from palp_core.palpation.studies.simulation.policy_summary import accuracies, joined, summarise
from palp_core.palpation.studies.simulation.reading_table import ReadingTable, tabulate
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


@dataclass(frozen=True)
class FilterDesign:
    """How trials are decided.

    Attributes:
        filter_name: ``naive`` or ``latent``.
        stop: The stop rule.
        training: Palpations a cell instead of the cell's own; 0: the cell's own.
        promise: Whether ``information_gain`` is given the model that knows what stays.
    """

    filter_name: str
    stop: StopRule
    training: int = 0
    promise: bool = False


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
    felt = tabulate(job.cell.gel)
    lines = {}
    for name, design in job.designs:
        sessions = dict(sessions_of(job.cell, felt, design, job.seeds))
        sessions["fixed_average"] = joined({one: sessions[one] for one in FIXED})
        lines[name] = {one: _line(sessions[one], felt.gel.depths_m) for one in POLICIES}
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
    cell: RobustnessCell, felt: ReadingTable, design: FilterDesign, seeds: Sequence[tuple[int, ...]]
) -> Mapping[str, Sequence[Outcomes]]:
    """Return the outcomes of every policy, a session each; ``fixed_average`` is not one."""
    conditions = replace(cell.conditions, training=design.training or cell.conditions.training)
    every: dict[str, list[Outcomes]] = {name: [] for name in POLICIES if name != "fixed_average"}
    for seed in seeds:
        session = begin_session(felt, conditions, seed)
        for name, kept in every.items():
            kept.append(_run(name, cell, session, design, every))
    return every


def _run(
    name: str,
    cell: RobustnessCell,
    session: SimulatedSession,
    design: FilterDesign,
    done: Mapping[str, Sequence[Outcomes]],
) -> Outcomes:
    if name == "fixed_best":  # it met the same luck as the position it is
        return done[fixed_name(session.best_ring_m)][-1]
    if name == "markov":
        return chain_outcomes(cell.markov(), session, design)
    asked = "information_gain_latent" if name == "information_gain" and design.promise else name
    return run_policy(asked, session, design.stop, filter_name=design.filter_name)


def chain_outcomes(chain: MarkovPolicy, session: SimulatedSession, design: FilterDesign) -> Outcomes:
    """Return what a chain does in a session."""
    model = session.naive if design.filter_name == "naive" else session.latent
    return run_trials(session.felt, model, chain, design.stop)


def promises(
    cell: RobustnessCell, seeds: Sequence[tuple[int, ...]], *, aware: bool
) -> dict[str, dict[str, float]]:
    """Return what information gain is promised by each ring position at the first probe.

    Args:
        cell: The cell.
        seeds: Of its sessions.
        aware: Whether by the model that knows what stays.

    Returns:
        By ring position in mm: ``bits``, a mean over sessions, and ``begin``, the share that begins there.
    """
    felt = tabulate(cell.gel)
    bits = []
    for seed in seeds:
        session = begin_session(felt, cell.conditions, seed)
        model = session.latent if aware else session.naive
        policy = InformationGainLatent(model, felt.gel.rings_m)
        bits.append(policy.actions(latent.start(model), None).gain_bits[:-1])
    first = np.bincount(np.argmax(bits, axis=1), minlength=len(felt.gel.rings_m)) / len(bits)
    return {
        f"{1e3 * ring_m:g}": {"bits": float(promised), "begin": float(share)}
        for ring_m, promised, share in zip(felt.gel.rings_m, np.mean(bits, axis=0), first, strict=True)
    }


@dataclass(frozen=True, eq=False)
class FamilyJob:
    """Members of the family of chains, shape (members, 3, 5, 5), in the centre's sessions."""

    matrices: Float64Array
    cell: RobustnessCell
    seeds: tuple[tuple[int, ...], ...]


def family_shares(job: FamilyJob) -> Float64Array:
    """Return the accuracy of each member in each session, shape (members, s)."""
    felt = tabulate(job.cell.gel)
    sessions = [begin_session(felt, job.cell.conditions, seed) for seed in job.seeds]
    return np.array(
        [
            accuracies([chain_outcomes(MarkovPolicy(each), one, DESIGNS["paper"]) for one in sessions])
            for each in job.matrices
        ]
    )
