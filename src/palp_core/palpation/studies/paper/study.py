"""The study ``paper``: the argument of the paper re-run, figure by figure, next to what it published."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from palp_core.palpation.perception.strategy import figure5, markov
from palp_core.palpation.studies.paper import figures
from palp_core.palpation.studies.paper.cases import (
    judge_scenes,
    paper_case,
    positions,
    why_report,
)
from palp_core.palpation.studies.paper.numbers import PUBLISHED, TABLE_3, TABLE_4, TABLE_6
from palp_core.palpation.studies.paper.statistics import analyses, comparisons, iterations, power_report
from palp_core.palpation.studies.parallel import Runner
from palp_core.palpation.studies.plan import Conditions, Gel
from palp_core.palpation.studies.schemes import FIXED, POLICIES, SessionRuns
from palp_core.palpation.studies.schemes import run as run_cases
from palp_core.palpation.studies.session import WorldPlan
from palp_core.palpation.studies.summary import at_most, joined, publish, summarise
from palp_core.palpation.studies.training import begin_trained
from palp_core.palpation.studies.trials import Outcomes

FULL, QUICK = (40, 100, 20, 100), (8, 0, 0, 40)
"""Sessions of the paper's design, of each scene, of each hypothesis; trials per depth and session."""


def run(
    out: Path, *, quick: bool = False, workers: int = 1, dask: str = "", sessions: int = 0, seed: int = 1
) -> Path:
    """Run the study, write ``paper.json``, the charts and the page, and return the page."""
    count, few, each, trials = QUICK if quick else FULL
    gel, conditions = Gel(), Conditions(trials=trials)
    plan, runner = WorldPlan(gel=gel, conditions=conditions), Runner(seed, workers, dask)
    ended = paper_sessions(plan, at_most(count, sessions), runner)
    contacts = {gel.chosen_rung(depth_m) for depth_m in gel.depths_m}
    report = results(ended, gel.depths_m) | {
        "quick": quick,
        "seed": seed,
        "conditions": asdict(conditions) | asdict(gel) | {"contact_model": sorted(contacts)},
        "positions": positions(plan),
        "scenes": judge_scenes(at_most(few, sessions), runner),
        "why": why_report(at_most(each, sessions), 40, runner),
    }
    trained = begin_trained(plan, (0, seed, 0))
    charts = [
        figures.figure_3(seed),
        figures.figure_4(),
        figures.figure_5(),
        figures.figure_7b(gel),
        figures.figure_8(gel, conditions, seed, count=8 if quick else 25),
        figures.figure_9(trained.primitives),
        *figures.figures_10_and_11(ended, gel.depths_m, report["iterations"]),
        figures.figure_12(report["policies"]),
        figures.policies_chart(report["policies"]),
    ]
    return publish(out, "paper", charts, report=report, tables={})


def paper_sessions(plan: WorldPlan, count: int, runner: Runner) -> dict[str, list[Outcomes]]:
    """Return how the trials of every policy ended, a session each."""
    case = paper_case(plan)
    found: SessionRuns = run_cases([case], count, runner, stream=0, label="sessions")[case.name]
    return {name: [one[name].ended for one in found] for name in found[0]}


def results(sessions: Mapping[str, Sequence[Outcomes]], depths_m: Sequence[float]) -> dict[str, Any]:
    """Return policies, tables, tests and comparisons as plain numbers."""
    average = summarise(joined({name: sessions[name] for name in FIXED}), depths_m)
    lines = {name: summarise(sessions[name], depths_m) for name in POLICIES}
    at = POLICIES.index("fixed_best")
    ordered = [*POLICIES[:at], "fixed_average", *POLICIES[at:]]
    return {
        "policies": {name: average if name == "fixed_average" else lines[name] for name in ordered},
        "published": PUBLISHED,
        "analyses_of_variance": analyses(sessions, depths_m),
        "iterations": iterations(sessions["markov"], depths_m),
        "comparisons": comparisons(sessions, average["per_session"]),
        "power": power_report(sessions, len(depths_m)),
        "tables": _tables(),
    }


def _tables() -> dict[str, Any]:
    """Return Tables 3 to 6; 5 with the reconstruction's own eigenvalues."""
    ours = [markov.eigenvalues(matrix).real.tolist() for matrix in figure5.matrices()]
    return {
        "3_training_order_mm": list(TABLE_3),
        "4_estimation_order_mm": list(TABLE_4),
        "5_eigenvalues": {
            f"{d * 1e3:g}": {"published": list(theirs), "reconstruction": mine}
            for d, theirs, mine in zip(figure5.DEPTHS_M, figure5.EIGENVALUES, ours, strict=True)
        },
        "6_level_to_ring_mm": [list(row) for row in TABLE_6],
    }
