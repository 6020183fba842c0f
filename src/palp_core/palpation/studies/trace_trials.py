"""Trials decided by whole traces, bin by bin or sweep by sweep."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palp_core.palpation.perception.belief.latent import of_classes
from palp_core.palpation.perception.belief.stopping import BeliefStep, StopRule
from palp_core.palpation.perception.strategy.policies import StiffnessPolicy, given
from palp_core.palpation.perception.trace.belief import (
    TraceBelief,
    begin_sweep,
    expected_bits,
    observe_stepwise,
    start,
)
from palp_core.palpation.perception.trace.model import TraceModel
from palp_core.palpation.perception.trace.training import learn
from palp_core.palpation.session.trace_settings import TraceSettings
from palp_core.palpation.studies.plan import Protocol
from palp_core.palpation.studies.session import FINE_M, Indices, WorldSession
from palp_core.palpation.studies.training import nearest
from palp_core.palpation.studies.trials import Outcomes
from palp_core.units import Float64Array

BIN_M = 0.002
MAX_SWEEPS = 6
"""Sweeps of a trial that are read by their traces: more were never needed."""
_TOGETHER = round(BIN_M / FINE_M)


def coarse(traces: Float64Array) -> Float64Array:
    """Return traces in the bins of the filter, from fine ones, shape (n, bins)."""
    count = traces.shape[1] // _TOGETHER
    return np.asarray(traces[:, : count * _TOGETHER].reshape(len(traces), count, _TOGETHER).mean(axis=2))


def settings_of(session: WorldSession, *, depths: int = 0) -> TraceSettings:
    """Return the estimator's settings on this rig: its path, and spreads as a lab states them beforehand."""
    low_m, high_m = session.plan.path_m
    return TraceSettings(from_m=low_m, to_m=high_m, run_in=session.plan.run_in, depths=depths)


def model_of(
    session: WorldSession, settings: TraceSettings, trace_filter: str = "second_order"
) -> TraceModel:
    """Return the trace filter's model after the session's training, by the nominal scene."""
    training, gel = session.training, session.plan.gel
    trained = learn(
        coarse(training.traces),
        np.asarray(gel.depths_m)[training.depth].tolist(),
        np.asarray(gel.rings_m)[training.ring].tolist(),
        training.mounting.tolist(),
        floor_n_m=settings.floor_n_m,
    )
    scene = gel.scene(gel.depths_m[0], "trace")
    return settings.model(trained, scene=scene, trace_filter=trace_filter)


def run_trace_trials(
    session: WorldSession,
    model: TraceModel,
    protocol: Protocol,
    rings: Indices | None,
    stop: StopRule,
    *,
    depths_m: tuple[float, ...] = (),
) -> Outcomes:
    """Run every trial to its verdict; the estimate is the session's depth nearest to the belief's."""
    rings_m, classes_m = np.asarray(session.rings_m), np.asarray(depths_m or session.depths_m)
    count, m = len(session.depth), model.class_count
    end = np.full((count, m), 1.0 / m)
    probes, moves = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    seconds, decided, error_m = np.zeros(count), np.zeros(count, dtype=bool), np.zeros(count)
    groups: list[tuple[Indices, TraceBelief, int]] = [(np.arange(count), start(model, count), -1)]
    for t in range(MAX_SWEEPS):
        following: list[tuple[Indices, TraceBelief, int]] = []
        for trials, belief, before in groups:
            if rings is None:
                asked = _most_information(model, session, protocol, belief, before)
            else:
                asked = rings[trials] if rings.ndim == 1 else rings[trials, t]
            for setting in np.unique(asked):
                here = asked == setting
                some, known = trials[here], belief[here]
                moved = before != setting
                seconds[some] += _travel_s(protocol, rings_m, before, int(setting))
                moves[some] += int(moved and before >= 0)
                if moved:
                    stays = rings is not None and rings.ndim == 1
                    error_m[some] = session.kept_landing_m[some] if stays else session.landings_m[some, t]
                known = begin_sweep(known, int(setting), landed=bool(moved))
                felt = coarse(session.traces(some, np.full(len(some), setting), error_m[some], t))
                after, posterior = observe_stepwise(model, known, felt)
                halt, last = _ended(stop, protocol, posterior, end[some], t + 1)
                end[some] = posterior[np.arange(len(some)), last]
                probes[some], decided[some] = t + 1, halt
                way_m = np.asarray((last + 1) * BIN_M, dtype=np.float64)
                seconds[some] += protocol.sweep_s(way_m) + protocol.back_s(way_m)
                if (~halt).any():
                    following.append((some[~halt], after[~halt], int(setting)))
        groups = following
        if not groups:
            break
    estimate = nearest(classes_m, np.asarray(session.depths_m))[np.argmax(end, axis=1)]
    right = (estimate == session.depth)[:, None]
    confidence, expected_m = end.max(axis=1), (end @ classes_m)[:, None]
    return Outcomes(session.depth, estimate, confidence, probes, moves, seconds, decided, expected_m, right)


def _ended(
    stop: StopRule, protocol: Protocol, posterior: Float64Array, before: Float64Array, probes: int
) -> tuple[NDArray[np.bool_], Indices]:
    """Return whether trials end within a sweep, and after which of its bins, from posteriors (n, bins, m)."""
    found = np.zeros(posterior.shape[:2], dtype=bool)
    asked = slice(None) if protocol.in_sweep and stop.within_a_sweep else slice(-1, None)
    flat = np.full(before.shape[1], 1.0 / before.shape[1])
    step = BeliefStep.over(flat, posterior[:, asked], before[:, None], probes)
    found[:, asked] = stop.check(step).converged
    return first_sure(found)


def first_sure(sure: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], Indices]:
    """Return whether trials end within a sweep and after which bin, else its last; from shape (n, bins)."""
    halt = np.asarray(sure.any(axis=1))
    return halt, np.asarray(np.where(halt, np.argmax(sure, axis=1), sure.shape[1] - 1))


def draw_rings(policy: StiffnessPolicy, session: WorldSession) -> Indices:
    """Return the rings of a policy that goes by chance alone, shape (n, t)."""
    count, most = session.uniforms.shape
    slot = nearest(np.asarray(policy.rings_m), np.asarray(session.rings_m))
    at = policy.start(given(session.uniforms[:, 0]), count)
    found = [slot[at.level]]
    flat = of_classes(np.full((count, len(session.depths_m)), 1.0 / len(session.depths_m)))
    for probe in range(1, most):
        at = policy.step(at, flat, given(session.uniforms[:, probe]))
        found.append(slot[at.level])
    return np.stack(found, axis=1)


def _most_information(
    model: TraceModel, session: WorldSession, protocol: Protocol, belief: TraceBelief, before: int
) -> Indices:
    """Return where a whole sweep is expected to tell most about the class per second, shape (n,)."""
    rings_m = np.asarray(session.rings_m)
    settings, sweep_s = range(len(rings_m)), protocol.timing.sweep_s
    bits = np.stack([expected_bits(model, belief, s, landed=before != s) for s in settings], axis=1)
    cost = np.array([sweep_s + _travel_s(protocol, rings_m, before, s) for s in settings])
    return np.asarray(np.argmax(bits / cost, axis=1), dtype=np.int64)


def _travel_s(protocol: Protocol, rings_m: Float64Array, before: int, setting: int) -> float:
    timing = protocol.timing
    if before >= 0:
        return float(timing.move_s(rings_m[before], rings_m[setting]))
    if not protocol.rehome:
        return 0.0
    return float((rings_m[setting] + timing.home_m) / timing.ring_m_per_s + timing.settle_s)
