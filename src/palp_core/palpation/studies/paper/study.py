"""The study ``paper``: the argument of the paper re-run, figure by figure, next to what it published."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from palp_core.palpation.perception.belief.stopping import PaperVerbatim
from palp_core.palpation.perception.strategy import figure5, markov
from palp_core.palpation.reporting.charts import Chart
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.studies.paper import charts_human, charts_probe, charts_results
from palp_core.palpation.studies.paper.numbers import PUBLISHED, TABLE_3, TABLE_4, TABLE_6, statements
from palp_core.palpation.studies.paper.power import power_report
from palp_core.palpation.studies.paper.scenes import SCENES, judge, scene_session
from palp_core.palpation.studies.paper.tests import analyses, comparisons, iterations
from palp_core.palpation.studies.paper.why import HYPOTHESES, positions, why_rows
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.gel import Gel
from palp_core.palpation.studies.simulation.policies import FIXED, NAMES, begin_trained, run_policy
from palp_core.palpation.studies.simulation.policy_summary import average_of, summarise
from palp_core.palpation.studies.simulation.session import WorldPlan
from palp_core.palpation.studies.simulation.trials import Outcomes
from palp_core.palpation.studies.toolkit.parallel import Runner
from palp_core.whole_file import write_json

READINGS = ("markov", "markov_gaussian_reset", "markov_mean")
"""Readings of eqs. (4) and (5)."""


@dataclass(frozen=True)
class PaperSize:
    """How much is run.

    Attributes:
        sessions: Sessions of the paper's design.
        scene_sessions: Sessions of each scene.
        why_sessions: Sessions of each hypothesis; 0 leaves them out.
        trials: Trials per depth and session; 100 as published.
    """

    sessions: int = 40
    scene_sessions: int = 100
    why_sessions: int = 20
    trials: int = 100


QUICK = PaperSize(
    sessions=8,
    scene_sessions=0,
    why_sessions=0,
    trials=40,
)


def run(out: Path, *, quick: bool = False, workers: int = 1, dask: str = "", seed: int = 1) -> Path:
    """Run the study and write ``paper.json``, the charts and the page.

    Args:
        out: Folder for the files; made if missing.
        quick: Few sessions, no scenes, no hypotheses.
        workers: Local processes.
        dask: Address of a Dask scheduler instead.
        seed: Of everything; results do not depend on the workers.

    Returns:
        The page.
    """
    size = QUICK if quick else PaperSize()
    gel, conditions = Gel(), Conditions(trials=size.trials)
    plan, runner = WorldPlan(gel=gel, conditions=conditions), Runner(seed, workers, dask)
    (found,) = runner.run(paper_session, [plan], size.sessions, stream=0, label="sessions")
    sessions = {name: [one[name] for one in found] for name in found[0]}
    contacts = {gel.chosen_rung(depth_m) for depth_m in gel.depths_m}
    report = results(sessions, gel.depths_m) | {
        "quick": quick,
        "seed": seed,
        "conditions": asdict(conditions) | asdict(gel) | {"contact_model": sorted(contacts)},
        "positions": positions(plan),
        "scenes": _scenes(size, runner),
        "why": _why(size, runner),
    }
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "paper.json", report)
    trained = begin_trained(plan, (0, seed, 0))
    charts: list[Chart] = [
        charts_human.figure_3(seed),
        charts_human.figure_4(),
        charts_human.figure_5(),
        charts_probe.figure_7b(gel),
        charts_probe.figure_8(gel, conditions, seed, count=8 if quick else 25),
        charts_probe.figure_9(trained.primitives),
        *_belief_charts(sessions, gel.depths_m, report["iterations"]),
        charts_results.figure_12(report["policies"]),
        charts_results.policies_chart(report["policies"]),
        charts_results.calibration_chart(report["policies"]),
    ]
    pictures = [picture(chart, out) for chart in charts]
    return write_page(out / "index.html", "studies/paper.html", report=report, pictures=pictures)


def paper_session(plan: WorldPlan, seed: tuple[int, ...]) -> dict[str, Outcomes]:
    """Return what every policy does in a session: peak, the paper's filter, its stop rule verbatim."""
    trained = begin_trained(plan, seed)
    return {name: run_policy(name, trained, PaperVerbatim()) for name in (*NAMES, *READINGS[1:])}


def results(sessions: Mapping[str, Sequence[Outcomes]], depths_m: Sequence[float]) -> dict[str, Any]:
    """Return policies, tables, tests and comparisons as plain numbers."""
    average = average_of({name: sessions[name] for name in FIXED}, depths_m)
    lines = {name: summarise(sessions[name], depths_m) for name in NAMES}
    at = NAMES.index("fixed_best")
    ordered = [*NAMES[:at], "fixed_average", *NAMES[at:]]
    return {
        "policies": {name: average if name == "fixed_average" else lines[name] for name in ordered},
        "readings_of_4_and_5": {name: summarise(sessions[name], depths_m) for name in READINGS},
        "published": PUBLISHED,
        "statements_from_published_counts": [asdict(one) for one in statements()],
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


def _scenes(size: PaperSize, runner: Runner) -> dict[str, Any]:
    judged = {}
    for number, (name, plan) in enumerate(SCENES.items() if size.scene_sessions else ()):
        label = f"sessions, scene {name}"
        (found,) = runner.run(scene_session, [plan], size.scene_sessions, stream=1 + number, label=label)
        judged[name] = judge(found, plan.gel.depths_m)
    return judged


def _why(size: PaperSize, runner: Runner) -> dict[str, Any]:
    """Return what each hypothesis is, and a line per cell; nothing where they are left out."""
    if not size.why_sessions:
        return {}
    return {
        "hypotheses": {name: words for name, (words, _) in HYPOTHESES.items()},
        "cells": why_rows(size.why_sessions, 40, runner),
    }


def _belief_charts(
    sessions: Mapping[str, Sequence[Outcomes]], depths_m: Sequence[float], took: Mapping[str, Any]
) -> list[Chart]:
    ours = ", ".join(f"{one['value']:.2f} at {depth} mm" for depth, one in took["by_depth"].items())
    return [
        charts_results.beliefs(
            "figure_10_fixed_16",
            "Figure 10: belief over iterations, fixed r_a = 16 mm",
            "The paper reports no progress over iterations and shows an example. Ours: mean over sessions "
            "with its standard error. A trial that has stopped keeps its last belief.",
            sessions["fixed_16"],
            depths_m,
        ),
        charts_results.beliefs(
            "figure_10_fixed_8",
            "Figure 10: belief over iterations, fixed r_a = 8 mm",
            "As before at the middle position: the readings of a trial share one landing of the ring, so "
            "further probes hardly move the mean.",
            sessions["fixed_8"],
            depths_m,
        ),
        charts_results.beliefs(
            "figure_11_markov",
            "Figure 11: belief over iterations, human strategy",
            "The paper: most trials end within 5 iterations, more the deeper the nodule. Ours took "
            f"{ours} on average, with the reconstructed average matrix, read as draws from its columns.",
            sessions["markov"],
            depths_m,
        ),
    ]
