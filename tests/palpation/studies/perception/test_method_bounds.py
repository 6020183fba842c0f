"""What the methods of perception state is what they keep, on sessions simulated here."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pytest
from msgspec import structs

from palp_core.methods import Quantities, find, names
from palp_core.methods.measured import measure_of
from palp_core.palpation.mechanics import Scene, run_scene
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.stopping import stop_rule
from palp_core.palpation.perception.strategy.policies import (
    FixedRing,
    MarkovPolicy,
    StiffnessPolicy,
    UniformRings,
)
from palp_core.palpation.session.method_choices import of_traces
from palp_core.palpation.session.trace_settings import TraceSettings
from palp_core.palpation.studies.measures.perception import (
    LAST,
    REMOUNTED,
    RULES,
    Trials,
    decide,
    miscalibrated,
    sessions,
    trials_by_policy,
)
from palp_core.palpation.studies.plan import RATE_HZ, SPEED_M_PER_S, Conditions, Gel
from palp_core.palpation.world.model import LAB, PAPER
from tests.support import reading_errors, trace_errors
from tests.support.trace_errors import RIG, TraceCase

RINGS_M = (0.004, 0.016)
TOUCHES: Sequence[dict[str, Any]] = (
    {},
    {"modulus_pa": 15e3},
    {"modulus_pa": 30e3},
    {"friction": 0.25},
    {"friction": 0.45},
    {"indentation_m": 0.003},
    {"indentation_m": 0.005},
    {"depths_m": (0.002, 0.006)},
    {"depths_m": (0.0015, 0.003, 0.006, 0.012), "tolerance": 0.05},  # of the contrast at 12 mm
    {"modulus_pa": 30e3, "friction": 0.45, "indentation_m": 0.003},
)
"""About the published touch, which is the first."""
TRACED_TOUCHES = (
    Gel(modulus_pa=15e3, friction=0.45, indentation_m=0.003),
    Gel(modulus_pa=30e3, friction=0.25, indentation_m=0.0045),
    Gel(depths_m=(0.003, 0.006)),
    Gel(depths_m=(0.0015, 0.003, 0.006, 0.012)),
    Gel(depths_m=(0.004, 0.006, 0.009)),
)
SPREADS_M = ((0.0, 0.0), (0.1e-3, 0.0), (0.3e-3, 0.0), (0.0, 0.1e-3), (0.3e-3, 0.03e-3), (0.3e-3, 0.1e-3))
"""Repeatability of the ring and spread of the height."""
RIGS_M = ((0.3e-3, 0.1e-3), (0.3e-3, 0.0), (0.1e-3, 0.1e-3), (0.3e-3, 0.05e-3))
"""The same, of sessions for stop rules and policies; the first is the published one."""
GAPS_SD = (2.0, 3.0, 4.0, 6.0)
OUTPUTS = ("feature", "decision", "calibration")
Errors = Mapping[str, Mapping[str, float]]
"""By method and output."""


def at_night(*columns: Sequence[Any]) -> list[Any]:
    """Return every combination of the columns' values as a row of the nightly run."""
    return [pytest.param(*row, marks=pytest.mark.nightly) for row in itertools.product(*columns)]


def quantities(gel: Gel, conditions: Conditions | None = None) -> Quantities:
    """Return what methods may know of a simulated touch, and of its session if there is one."""
    depths_m = sorted(gel.depths_m)
    found: Quantities = {
        **gel.scene(depths_m[0]).quantities(),
        "depth_m": gel.depths_m,
        "speed_m_s": SPEED_M_PER_S,
        "sample_hz": RATE_HZ,
        "noise_n_m": gel.noise_factor * RESOLUTION_N_M,
        "stiffest_m": max(gel.rings_m),
        "class_count": float(len(depths_m)),
        "class_ratio": min(b / a for a, b in itertools.pairwise(depths_m)),
    }
    if conditions is None:
        return found
    return {
        **found,
        "training_count": float(conditions.training),
        "probe_count": float(conditions.max_probes),
        "ring_sd_m": conditions.ring_sd_m,
        "height_sd_m": conditions.height_sd_m,
        "outlier_share": 0.0,
    }


def broken(task: str, where: Quantities, errors: Errors) -> list[str]:
    """Return the bounds that errors are beyond, in words; a method that states none there breaks none."""
    return [
        f"{name}: {output} off by {error:.4g}, stated {bound:.4g}"
        for name, of in errors.items()
        for output, error in of.items()
        if (bound := find(task, name).bound(output, where)) is not None and error > bound
    ]


@pytest.mark.parametrize(
    ("touch", "noise", "sweeps"), [({}, 5.0, 10), *at_night(TOUCHES, (1.0, 2.0, 5.0), (60,))]
)
def test_rules_for_wavelet_coefficients_keep_their_bounds(
    touch: dict[str, Any], noise: float, sweeps: int
) -> None:
    gel = Gel(rings_m=RINGS_M, noise_factor=noise, **touch)
    clean = reading_errors.clean_sweeps(RINGS_M, gel)
    errors = {
        rule: {"feature": reading_errors.feature_error(rule, clean, noise, sweeps)}
        for rule in names("denoise")
    }
    assert broken("denoise", quantities(gel), errors) == []


@pytest.mark.parametrize(("touch", "noise", "height_m"), at_night(TOUCHES, (1.0, 5.0), (0.0, 0.1e-3, 0.2e-3)))
def test_features_keep_their_bounds(touch: dict[str, Any], noise: float, height_m: float) -> None:
    gel = Gel(rings_m=RINGS_M, noise_factor=noise, height_reach_m=0.9e-3, **touch)
    rig = replace(REMOUNTED, height_sd_m=height_m)
    errors = {
        name: {"decision": reading_errors.one_reading(name, gel, rig, 100)} for name in names("feature")
    }
    assert broken("feature", quantities(gel, rig), errors) == []


@pytest.mark.parametrize(
    ("training", "outliers", "gaps_sd", "trials"),
    [
        (5, 0.0, (2.0,), 10000),
        (25, 0.01, (2.0,), 10000),
        *at_night((3, 5, 10, 25, 100), (0.0, 0.01), (GAPS_SD,), (40000,)),
    ],
)
def test_likelihoods_keep_their_bounds(
    training: int, outliers: float, gaps_sd: tuple[float, ...], trials: int
) -> None:
    errors = {
        name: {
            "calibration": max(
                reading_errors.overtrust(name, training, gap_sd, outliers, trials, probes=probes)
                for gap_sd in gaps_sd
                for probes in (1, 15)
            )
        }
        for name in names("likelihood")
    }
    where: Quantities = {
        "training_count": float(training),
        "class_gap_sd": (min(GAPS_SD), max(GAPS_SD)),
        "class_count": 3.0,
        "outlier_share": outliers,
        "probe_count": 15.0,
    }
    assert broken("likelihood", where, errors) == []


@pytest.mark.parametrize(("spread_m", "training"), at_night(SPREADS_M, (10, 25)))
def test_filters_keep_their_bounds(spread_m: tuple[float, float], training: int) -> None:
    """Worst of the best fixed ring, where readings share most, uniform draws, and the human chain."""
    ring_m, height_m = spread_m
    rig = replace(REMOUNTED, repeatability_m=ring_m, height_sd_m=height_m, training=training)
    begun = sessions(Gel(), rig, 100)
    errors = {
        name: {
            "calibration": max(
                miscalibrated([decide(one, name, policy, rule) for one in begun])
                for policy in (FixedRing(), UniformRings(), MarkovPolicy())
                for rule in RULES
            )
        }
        for name in names("filter")
    }
    assert broken("filter", quantities(Gel(), rig), errors) == []
    if (spread_m, training) == (SPREADS_M[-1], 25):
        assert errors["naive"]["calibration"] > 3.0 * errors["latent"]["calibration"]
        assert errors["latent"]["calibration"] < 0.05


@pytest.mark.parametrize("spread_m", at_night(RIGS_M))
def test_stop_rules_keep_their_bounds(spread_m: tuple[float, float]) -> None:
    """What each loses against going on to the last probe; worst of policies and filters."""
    rig = replace(REMOUNTED, repeatability_m=spread_m[0], height_sd_m=spread_m[1])
    begun = sessions(Gel(), rig, 100)
    errors = {name: {"decision": 0.0, "calibration": 0.0} for name in names("stop")}
    policies: tuple[StiffnessPolicy, ...] = (FixedRing(), UniformRings())
    for policy, known in itertools.product(policies, ("naive", "latent")):
        last = Trials.of([decide(one, known, policy, LAST) for one in begun])
        for name, worst in errors.items():
            ended = Trials.of([decide(one, known, policy, stop_rule(name)) for one in begun])
            worst["decision"] = max(worst["decision"], ended.wrong - last.wrong)
            worst["calibration"] = max(worst["calibration"], ended.overconfidence - last.overconfidence)
    assert broken("stop", quantities(Gel(), rig), errors) == []


@pytest.mark.parametrize("spread_m", at_night(RIGS_M))
def test_policies_keep_their_bounds(spread_m: tuple[float, float]) -> None:
    """Which share of decisions each gets wrong beyond the best one; worst of the filters."""
    rig = replace(REMOUNTED, repeatability_m=spread_m[0], height_sd_m=spread_m[1])
    begun = sessions(Gel(), rig, 60)
    wrong = [
        {name: one.wrong for name, one in trials_by_policy(begun, known).items()}
        for known in ("naive", "latent")
    ]
    errors = {
        name: {"decision": max(by_name[name] - min(by_name.values()) for by_name in wrong)}
        for name in wrong[0]
    }
    assert broken("policy", quantities(Gel(), rig), errors) == []


def spread_as_assumed(share: float, run_in: bool, gel: Gel | None = None) -> TraceCase:
    """Return sessions whose phantoms and mountings spread as widely as their filter assumes, and no less.

    Args:
        share: Of the usual spreads that a filter assumes: friction and modulus a tenth, heights 0.2 mm, the
            bead 1 mm along and to the side of the path, the ball 0.1 mm.
        run_in: Whether the sweep begins upright and the surface has a texture, as in the lab's world.
        gel: What is touched.
    """
    usual = TraceSettings()
    place_m = share * usual.place_sd_mm * 1e-3 * 0.5**0.5  # by phantom, and by mounting
    world = replace(
        LAB if run_in else PAPER,
        friction_mounting_sd=share * usual.friction_sd,
        modulus_specimen_sd=share * usual.modulus_sd,
        layer_modulus_sd=0.0,
        bead_along_specimen_sd_m=place_m,
        bead_along_mounting_sd_m=place_m,
        bead_beside_specimen_sd_m=place_m,
        bead_beside_mounting_sd_m=place_m,
    )
    spreads = ("friction_sd", "modulus_sd", "place_sd_mm", "trace_height_sd_mm", "tip_sd_mm")
    assumed = {name: share * getattr(usual, name) for name in spreads}
    height_m = share * usual.trace_height_sd_mm * 1e-3
    return TraceCase(gel or Gel(), world, replace(RIG, height_sd_m=height_m), assumed)


SPREADS = ("trace_height_sd_m", "friction_sd", "modulus_sd", "place_sd_m", "tip_sd_m")
ONE_PHANTOM = replace(RIG, training=2, phantoms=1)
"""Two palpations a cell, all of one phantom, and trials of others."""


def assuming(case: TraceCase, **assumed: float) -> TraceCase:
    return replace(case, assumed={**case.assumed, **assumed})


def traced() -> list[TraceCase]:
    """Return sessions by touch, spread, training and noise, in either world."""
    found = [TraceCase(world=LAB), TraceCase(world=PAPER)]
    for run_in in (True, False):
        usual = spread_as_assumed(1.0, run_in)
        rigs = [replace(RIG, training=count) for count in (3, 6, 60)]
        rigs += [ONE_PHANTOM, replace(RIG, repeatability_m=0.0)]
        found += [spread_as_assumed(share, run_in) for share in (0.1, 0.5, 1.0, 2.0)]
        found += [spread_as_assumed(1.0, run_in, touch) for touch in TRACED_TOUCHES]
        found += [
            replace(usual, conditions=replace(rig, height_sd_m=usual.conditions.height_sd_m)) for rig in rigs
        ]
        found += [
            spread_as_assumed(1.0, run_in, Gel(noise_factor=5.0)),
            assuming(usual, depths=31),
            assuming(usual, slope_error=0.3, texture_sd_n_mm=0.4),
        ]
    return [*found, assuming(spread_as_assumed(1.0, False), slope_error=0.0, texture_sd_n_mm=0.05)]


@pytest.mark.parametrize("case", at_night(traced()))
def test_filters_of_traces_keep_their_bounds(case: TraceCase) -> None:
    errors = trace_errors.errors(trace_errors.by_filter(case, case.sessions(6)))
    settings = structs.replace(TraceSettings(), **case.assumed)
    grid = {"class_count": float(settings.depths)} if settings.depths else {}
    told = of_traces(settings)
    if case.conditions.phantoms == 1:  # others differ from the one of training by more than phantoms scatter
        told |= {name: 2.0**0.5 * value for name, value in told.items() if name in SPREADS}
    where = {**quantities(case.gel, case.conditions), **told, **grid}
    assert broken(trace_errors.TASK, where, errors) == []


def test_an_error_beyond_its_bound_is_seen() -> None:
    where = quantities(Gel(rings_m=RINGS_M))
    bound = find("denoise", "soft_universal").bound("feature", where)
    assert bound is not None
    errors = {"soft_universal": {"feature": 2.0 * bound}}
    assert len(broken("denoise", where, errors)) == 1
    assert broken("denoise", {**where, "modulus_pa": 1e6}, errors) == []


@pytest.mark.parametrize(
    "task", ["denoise", "feature", "likelihood", "filter", "stop", "policy", "trace_filter"]
)
def test_every_method_states_an_error_in_the_published_session(task: str) -> None:
    published = quantities(Gel(rings_m=RINGS_M), REMOUNTED)
    where = {**published, **of_traces(TraceSettings()), "class_gap_sd": (min(GAPS_SD), max(GAPS_SD))}
    silent = {name for name in names(task) if not any(find(task, name).bound(o, where) for o in OUTPUTS)}
    assert silent <= {"emg_driven"}


def test_sweeps_have_the_truth_of_their_own() -> None:
    gel = Gel()
    clean = reading_errors.clean_sweeps((0.016,), gel)
    scenes = [Scene(ring_m=(0.016,)).with_bead(depth_m) for depth_m in gel.depths_m]
    peaks = [run_scene(scene, "l2").peak_n_m[0] for scene in scenes]
    assert [one.truth_n_m["peak"] for one in clean] == pytest.approx(peaks, rel=1e-3)
    assert all(gap > 0.0 for one in clean for gap in one.gap_n_m.values())


@pytest.mark.nightly
def test_a_stop_rule_is_measured_in_seconds_on_the_rig_too() -> None:
    seconds = {one.method: one.error for one in measure_of("stop")(Scene()) if one.output == "rig_s"}
    assert set(seconds) == set(names("stop"))
    assert seconds["fixed_number"] > seconds["paper"] > 8.0
