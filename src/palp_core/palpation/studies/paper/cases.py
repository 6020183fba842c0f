"""The cases of the study ``paper``: its own design, scenes fixed in advance, and why progress stops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palp_core.palpation.perception.belief.stopping import FixedNumber, PaperVerbatim, PosteriorThreshold
from palp_core.palpation.perception.statistics.resampling import (
    cluster_bootstrap,
    share_interval,
)
from palp_core.palpation.perception.strategy import figure5, markov
from palp_core.palpation.perception.strategy.policies_informed import Timing
from palp_core.palpation.studies.parallel import Runner
from palp_core.palpation.studies.plan import Conditions, Gel
from palp_core.palpation.studies.schemes import (
    FIXED,
    POLICIES,
    Case,
    Scheme,
    SessionRuns,
    run,
)
from palp_core.palpation.studies.session import WorldPlan
from palp_core.palpation.studies.summary import accuracies, ends, joined, some, summarise
from palp_core.palpation.studies.training import cell_readings, reading_slopes
from palp_core.palpation.studies.trials import Outcomes
from palp_core.units import Float64Array


def paper_case(plan: WorldPlan) -> Case:
    """Return every policy: peak, the paper's filter, its stop rule verbatim."""
    schemes = {name: Scheme(name, name) for name in POLICIES}
    schemes["best_single_probe"] = Scheme("best_single_probe", "best_single_probe", stop=FixedNumber(1))
    return Case("paper", plan, tuple(schemes.values()))


# Scenes fixed in advance: is information gain with the latent filter better at equal seconds?


_GAIN = "information_gain_latent"


def _scene(name: str, gel: Gel, height_sd_m: float, **conditions: Any) -> Case:
    plan = WorldPlan(
        gel=gel, conditions=Conditions(height_sd_m=height_sd_m, mounting="each_trial", **conditions)
    )
    last = FixedNumber(plan.conditions.max_probes)
    fixed = (
        Scheme(f"{policy}/{known}", policy, filter=known, stop=last)
        for policy in FIXED[1:]
        for known in ("naive", "latent")
    )
    return Case(name, plan, (Scheme(_GAIN, _GAIN, filter="latent", stop=PosteriorThreshold()), *fixed))


_NOISY = Gel(modulus_pa=30e3, noise_factor=5.0)
SCENES = (
    _scene("easy", Gel(), 0.0),
    _scene("noisy", _NOISY, 0.1e-3, training_lands="cell"),
    _scene("unknown_height", Gel(), 0.2e-3),
    _scene("noisy_re_homed", _NOISY, 0.1e-3),
)
"""Fixed in advance: ring error only; noise, stiff gel and blocked training as well; height not known.

The last is a control, added afterwards: the noisy scene with a training that repositions the ring each time.
"""


def judge_scenes(sessions: int, runner: Runner) -> dict[str, Any]:
    """Return the lines of each scene and its comparison at equal seconds; nothing for no sessions."""
    judged = {}
    for number, case in enumerate(SCENES if sessions else ()):
        found = run([case], sessions, runner, stream=1 + number, label=f"sessions, scene {case.name}")
        judged[case.name] = judge(found[case.name], case.plan.gel.depths_m)
    return judged


def judge(sessions: SessionRuns, depths_m: Sequence[float]) -> dict[str, Any]:
    """Return what information gain comes to, and its paired comparison with the best fixed ring.

    A fixed ring stops after the first number of probes at which it has taken at least as long, on average, as
    information gain; ring and filter are the best in hindsight.
    """
    runs = {name: [one[name].ended for one in sessions] for name in sessions[0]}
    gain = runs.pop(_GAIN)
    budget_s = float(np.mean([one.seconds.mean() for one in gain]))
    at_budget = {name: _right_at(found, budget_s) for name, found in runs.items()}
    best = max(at_budget, key=lambda name: float(np.mean(at_budget[name][0])))
    right, seconds = at_budget[best]
    shares = np.array([one.mean() for one in right])
    difference = cluster_bootstrap(accuracies(gain) - shares, np.random.default_rng(14), within=(-1.0, 1.0))
    fixed = share_interval(right, np.random.default_rng(15))
    return {
        _GAIN: summarise(gain, depths_m),
        "best_fixed": {"name": best, "accuracy": fixed.value, "ci": ends(fixed), "seconds": seconds},
        "difference": difference.value,
        "difference_ci": ends(difference),
    }


def _right_at(sessions: Sequence[Outcomes], budget_s: float) -> tuple[list[NDArray[np.bool_]], float]:
    """Return which trials of each session are right after the probes that fill the budget, and their time."""
    probes = sessions[0].right.shape[1]
    whole_s = float(np.mean([one.seconds.mean() for one in sessions]))
    sweep_s = Timing().sweep_s
    first_s = whole_s - (probes - 1) * sweep_s  # a fixed ring moves once
    count = int(np.clip(np.ceil((budget_s - first_s) / sweep_s + 1.0 - 1e-9), 1, probes))
    return [one.right[:, count - 1] for one in sessions], first_s + (count - 1) * sweep_s


# Which hypotheses make a fixed stiffness stop making progress? Each is a switch of the simulated rig.

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
HOLDS = {"H2": "H1"}
"""A hypothesis that has another in it: a ring that lands exactly has no landing to keep."""


def conditions_of(names: Sequence[str], trials: int) -> Conditions:
    """Return the control with the conditions of some hypotheses."""
    merged: dict[str, Any] = {}
    for name in names:
        merged |= HYPOTHESES[name][1]
    return replace(NONE, trials=trials, **merged)


def why_cells() -> dict[str, tuple[str, ...]]:
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


def why_case(name: str, held: Sequence[str], trials: int) -> Case:
    """Return the fixed positions under some hypotheses."""
    plan = WorldPlan(gel=Gel(), conditions=conditions_of(held, trials))
    stop = PaperVerbatim() if "H4" in held else FixedNumber(8)
    policies = FIXED if "H3" in held else FIXED[1:]
    return Case(name, plan, tuple(Scheme(policy, policy, stop=stop) for policy in policies))


def why_report(sessions: int, trials: int, runner: Runner) -> dict[str, Any]:
    """Return what each hypothesis is, and a line per cell; nothing for no sessions.

    A line is the average over fixed positions, and its progress from the first probe to the last.
    """
    if not sessions:
        return {}
    asked = [why_case(name, held, trials) for name, held in why_cells().items()]
    found = run(asked, sessions, runner, stream=30, label="sessions, hypotheses")
    lines = [{"cell": name, **_why_line(runs)} for name, runs in found.items()]
    return {"hypotheses": {name: words for name, (words, _) in HYPOTHESES.items()}, "cells": lines}


def _why_line(sessions: SessionRuns) -> dict[str, Any]:
    runs = {name: [one[name].ended for one in sessions] for name in sessions[0]}
    line = summarise(joined(runs), Gel().depths_m)
    gains = [
        np.mean([one.right[:, -1].mean() - one.right[:, 0].mean() for one in row])
        for row in zip(*runs.values(), strict=True)
    ]
    progress = cluster_bootstrap(np.array(gains), np.random.default_rng(15), within=(-1.0, 1.0))
    kept = some(line, "accuracy", "ci", "probes", "ece")
    return {**kept, "progress": progress.value, "progress_ci": ends(progress)}


def positions(plan: WorldPlan) -> list[dict[str, float]]:
    """Return a line per ring position: its information, and how often people are there.

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
