"""What ``palp methods measure`` measures of the methods of perception: error and CPU in a scene.

The session about the scene is the published one: landings, heights, training, noise. Policies and stop
rules also say how many seconds of rig a trial takes, as the output ``rig_s``, and which share of decisions is
wrong, as ``wrong``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from palp_core.methods import find, names
from palp_core.methods.measured import Measured, cpu_s
from palp_core.palpation.mechanics.scene.scene import PAPER_DEPTHS_M, Scene
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.latent import OffsetModel, start, update
from palp_core.palpation.perception.belief.stopping import BeliefStep, stop_rule
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.perception.strategy.figure5 import RINGS_M
from palp_core.palpation.perception.strategy.policies import FixedRing, UniformRings, given
from palp_core.palpation.perception.trace.belief import begin_sweep, observe_stepwise
from palp_core.palpation.perception.trace.belief import start as trace_start
from palp_core.palpation.studies.frontier.trace_trials import model_of
from palp_core.palpation.studies.perception import traces
from palp_core.palpation.studies.perception.beliefs import (
    REMOUNTED,
    RULES,
    decide,
    miscalibrated,
    one_reading,
    overtrust,
    sessions,
)
from palp_core.palpation.studies.perception.signals import CleanSweep, clean_sweeps, feature_error
from palp_core.palpation.studies.perception.traces import TraceCase
from palp_core.palpation.studies.perception.trials import (
    LAST,
    Trials,
    policy_of,
    trials_by_policy,
)
from palp_core.palpation.studies.simulation.gel import Gel
from palp_core.palpation.studies.simulation.policies import TrainedFeature
from palp_core.units import Float64Array

_FEW, _SWEEPS = 10, 10
_TRUTH = "simulated truth"


def gel_of(scene: Scene, rings_m: tuple[float, ...] = RINGS_M) -> Gel:
    """Return the touch of a scene over the depths that it compares, the paper's if it compares none."""
    return Gel(
        depths_m=scene.tolerance.compared_m or PAPER_DEPTHS_M,
        rings_m=rings_m,
        modulus_pa=scene.phantom.modulus_pa,
        friction=scene.probe.friction,
        tip_radius_m=scene.probe.tip_radius_m,
        indentation_m=scene.path.indentation_m,
        height_reach_m=min(0.9e-3, scene.path.indentation_m),
    )


def measure_denoising(scene: Scene) -> Iterator[Measured]:
    """Measure every rule for wavelet coefficients."""
    cases, noisy = _sweeps(scene)
    for rule in names("denoise"):
        cost_s = cpu_s(partial(denoise, noisy, rule=rule))
        error = feature_error(rule, cases, 1.0, _SWEEPS)
        yield Measured("denoise", rule, "", cost_s, error, "feature", _TRUTH)


def _sweeps(scene: Scene) -> tuple[list[CleanSweep], Float64Array]:
    rings_m = tuple(ring_m for ring_m in scene.ring_m if ring_m > 0.0) or (0.016,)
    cases = clean_sweeps(rings_m, gel_of(scene, rings_m))
    clean = cases[0].torque_n_m
    return cases, clean + RESOLUTION_N_M * np.random.default_rng(0).standard_normal(clean.size)


def measure_features(scene: Scene) -> Iterator[Measured]:
    """Measure every feature: wrong decisions from one reading at the stiffest ring."""
    rings_m = (max(scene.ring_m),)
    (case, *_) = clean_sweeps(rings_m, gel_of(scene, rings_m))
    for name in names("feature"):
        cost_s = cpu_s(partial(find("feature", name).target, case.torque_n_m, edge=edge_cone()))
        error = one_reading(name, gel_of(scene, rings_m), REMOUNTED, _FEW)
        yield Measured("feature", name, "", cost_s, error, "decision", _TRUTH)


def measure_likelihoods(scene: Scene) -> Iterator[Measured]:
    """Measure every likelihood with few, the published and many training readings a class."""
    begun = sessions(gel_of(scene), REMOUNTED, 1)[0]
    known = begun.primitives
    for count in (25, 5, 100):
        for name in names("likelihood"):
            cost_s = cpu_s(
                partial(known.log_likelihood, float(known.mean[0, -1]), -1 + known.rings_m.size, model=name)
            )
            error = max(overtrust(name, count, gap_sd, 0.0, 4000) for gap_sd in (2.0, 4.0))
            usual = count == REMOUNTED.training
            words = f"{count} readings a class"
            yield Measured("likelihood", name, words, cost_s, error, "calibration", "its own model", usual)


def measure_filters(scene: Scene) -> Iterator[Measured]:
    """Measure every filter: the confidence at the end of trials on the rig."""
    begun = sessions(gel_of(scene), REMOUNTED, _FEW)
    for name in names("filter"):
        model: OffsetModel = (
            begun[0].naive if name == "naive" else find("filter", name).target(begun[0].latent)
        )
        at = float(model.mean[0, -1, 0])
        cost_s = cpu_s(partial(update, model, start(model), at, model.mean.shape[1] - 1, moved=True))
        error = max(
            miscalibrated([decide(one, name, policy, rule) for one in begun])
            for policy in (FixedRing(), UniformRings())
            for rule in RULES
        )
        yield Measured("filter", name, "", cost_s, error, "calibration", _TRUTH)


def measure_trace_filters(scene: Scene) -> Iterator[Measured]:
    """Measure every filter of whole traces in the lab's world: one sweep a trial, at the stiffest ring."""
    case = TraceCase(replace(gel_of(scene), reading="trace"))
    begun = traces.sessions(case, 2)
    found = traces.errors(traces.by_filter(case, begun))
    for name in names(traces.TASK):
        model = model_of(begun[0], case.settings(begun[0]), name)
        ring = model.mean.shape[1] - 1
        sweep = begin_sweep(trace_start(model), ring, landed=True)
        cost_s = cpu_s(partial(observe_stepwise, model, sweep, model.mean[0, ring]))
        for output, error in found[name].items():
            yield Measured(traces.TASK, name, "", cost_s, error, output, _TRUTH)


def measure_stops(scene: Scene) -> Iterator[Measured]:
    """Measure every stop rule under uniform draws and the filter that knows what stays."""
    begun = sessions(gel_of(scene), REMOUNTED, _FEW)
    last = Trials.of([decide(one, "latent", UniformRings(), LAST) for one in begun])
    classes = len(begun[0].trials.depths_m)
    flat, sure = np.full(classes, 1.0 / classes), np.full(classes, 0.1 / (classes - 1))
    sure[0] = 0.9
    for name in names("stop"):
        rule = stop_rule(name)
        cost_s = cpu_s(lambda rule=rule: rule.check(BeliefStep.over(flat, sure, flat, 2)))  # type: ignore[misc]
        came = Trials.of([decide(one, "latent", UniformRings(), rule) for one in begun])
        yield from _outputs("stop", name, cost_s, came.wrong - last.wrong, came)


def measure_policies(scene: Scene) -> Iterator[Measured]:
    """Measure every policy that takes no person, under the filter that knows what stays."""
    begun = sessions(gel_of(scene), REMOUNTED, _FEW)
    came = trials_by_policy(begun, "latent")
    best = min(one.wrong for one in came.values())
    for name, one in came.items():
        yield from _outputs("policy", name, _step_s(name, begun[0]), one.wrong - best, one)


def _step_s(name: str, trained: TrainedFeature) -> float:
    policy = policy_of(name, trained)
    assert policy is not None
    belief = start(trained.latent if name == "information_gain_latent" else trained.naive)
    at = policy.start(given(0.5))
    return cpu_s(partial(policy.step, at, belief, given(0.5)))


def _outputs(task: str, method: str, cost_s: float, lost: float, came: Trials) -> Iterator[Measured]:
    """Give a method's points: what is lost, which share is wrong, and the seconds on the rig."""
    found: Mapping[str, Any] = {"decision": max(lost, 0.0), "wrong": came.wrong, "rig_s": came.rig_s}
    for output, error in found.items():
        yield Measured(task, method, "", cost_s, error, output, _TRUTH)
