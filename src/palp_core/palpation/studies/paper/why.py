"""Which hypotheses make a fixed stiffness stop making progress?

Each hypothesis is a switch of the simulated rig. Every one is run alone, and all but each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from palp_core.palpation.perception.belief.stopping import FixedNumber, PaperVerbatim
from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap
from palp_core.palpation.perception.strategy import figure5, markov
from palp_core.palpation.studies.simulation.cells import cell_readings, reading_slopes
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.gel import Gel
from palp_core.palpation.studies.simulation.policies import FIXED, begin_trained, run_policy
from palp_core.palpation.studies.simulation.policy_summary import average_of
from palp_core.palpation.studies.simulation.session import WorldPlan
from palp_core.palpation.studies.simulation.trials import Outcomes
from palp_core.palpation.studies.toolkit.parallel import Runner
from palp_core.units import Float64Array

NONE = Conditions(repeatability_m=0.0, height_sd_m=0.0)
"""The control: no shared error at all."""

HYPOTHESES: dict[str, tuple[str, dict[str, Any]]] = {
    "H1": ("the ring's error stays while the ring stays", {"repeatability_m": 0.3e-3}),
    "H2": (
        "as H1, and the ring is not re-homed between trials, nor within a cell of training",
        {"repeatability_m": 0.3e-3, "rehome": False, "training_lands": "cell"},
    ),
    "H3": ("the average runs over uninformative levels", {}),
    "H4": ("the correlation rule stops after two similar probes", {}),
    "H5": ("the phantom's height differs between mountings", {"height_sd_m": 0.1e-3}),
    "H6": ("a bias drifts between training and estimation", {"drift_n_m": 0.5e-3}),
    "H7": ("the same stored reading is used again", {"same_reading": True}),
}
"""What each is, and the conditions it sets; the drift of 0.5 N mm is assumed. H3 is which positions are
averaged, H4 the stop rule."""

PROBES = 8


def conditions_of(names: Sequence[str], trials: int) -> Conditions:
    """Return the control with the conditions of some hypotheses."""
    merged: dict[str, Any] = {}
    for name in names:
        merged |= HYPOTHESES[name][1]
    return replace(NONE, trials=trials, **merged)


@dataclass(frozen=True)
class WhyCase:
    """Sessions alike, and what is run in them."""

    plan: WorldPlan
    policies: tuple[str, ...]
    correlation_stop: bool


def why_session(case: WhyCase, seed: tuple[int, ...]) -> dict[str, Outcomes]:
    """Return what each policy does in a session."""
    stop = PaperVerbatim() if case.correlation_stop else FixedNumber(PROBES)
    trained = begin_trained(case.plan, seed)
    return {name: run_policy(name, trained, stop) for name in case.policies}


HOLDS = {"H2": "H1"}
"""A hypothesis that has another in it: a ring that lands exactly has no landing to keep."""


def cells() -> dict[str, tuple[str, ...]]:
    """Return the hypotheses of each run: none, each alone, all, and all but each and what holds it."""
    every = tuple(HYPOTHESES)
    return {
        "control": (),
        **{f"only {name}": (name,) for name in every},
        "all": every,
        **{
            f"all but {name}": tuple(one for one in every if name not in (one, HOLDS.get(one)))
            for name in every
        },
    }


def why_rows(session_count: int, trials: int, runner: Runner) -> list[dict[str, Any]]:
    """Return a line per cell: the average over fixed positions, and its progress over the probes."""
    cases = [
        WhyCase(
            WorldPlan(gel=Gel(), conditions=conditions_of(held, trials)),
            FIXED if "H3" in held else FIXED[1:],
            "H4" in held,
        )
        for held in cells().values()
    ]
    found = runner.run(why_session, cases, session_count, stream=30, label="sessions, hypotheses")
    rows = []
    for name, sessions in zip(cells(), found, strict=True):
        by_policy = {policy: [one[policy] for one in sessions] for policy in sessions[0]}
        rows.append({"cell": name, **_line(by_policy, Gel().depths_m)})
    return rows


def _line(sessions: dict[str, list[Outcomes]], depths_m: Sequence[float]) -> dict[str, Any]:
    """Return the average over the policies, and the progress from the first probe to the last."""
    line = average_of(sessions, depths_m)
    gains = [
        np.mean([one.right[:, -1].mean() - one.right[:, 0].mean() for one in row])
        for row in zip(*sessions.values(), strict=True)
    ]
    progress = cluster_bootstrap(np.array(gains), np.random.default_rng(15), within=(-1.0, 1.0))
    return {
        "accuracy": line["accuracy"],
        "ci": line["ci"],
        "probes": line["probes"],
        "ece": line["ece"],
        "progress": progress.value,
        "progress_ci": [progress.low, progress.high],
    }


def positions(plan: WorldPlan) -> list[dict[str, float]]:
    """Return a line per ring position: what it tells, and how often people are there.

    Returns:
        ``ring_mm``; ``gap_n_mm``, the least between neighbouring depths' readings; ``landing_n_mm`` and
        ``height_n_mm``, standard deviations of a reading by either, mean over depths; ``human``, the share of
        palpations that the reconstructed human strategy makes there in the long run.
    """
    spread, gel = plan.conditions, plan.gel
    landing, height = reading_slopes(plan, gel.reading)
    columns: dict[str, Float64Array] = {
        "ring_mm": 1e3 * np.asarray(gel.rings_m),
        "gap_n_mm": 1e3 * np.abs(np.diff(cell_readings(plan, gel.reading), axis=0)).min(axis=0),
        "landing_n_mm": 1e3 * np.abs(landing).mean(axis=0) * spread.ring_sd_m,
        "height_n_mm": 1e3 * np.abs(height).mean(axis=0) * spread.height_sd_m,
        "human": markov.stationary(np.mean(figure5.matrices(), axis=0)),
    }
    return [dict(zip(columns, map(float, line), strict=True)) for line in zip(*columns.values(), strict=True)]
