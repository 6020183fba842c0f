"""Decide many trials at once, by a feature of each sweep or by its whole trace."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PalpError
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.belief.stopping import BeliefStep, StopRule
from palp_core.palpation.perception.strategy.policies import FixedRing, StiffnessPolicy, given
from palp_core.palpation.perception.strategy.policies_informed import InformationGainLatent, Timing
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
from palp_core.palpation.studies.training import TrainedFeature, nearest
from palp_core.units import Float64Array

BIN_M = 0.002
MAX_SWEEPS = 6
"""Sweeps of a trial that are read by their traces: more were never needed."""
_TOGETHER = round(BIN_M / FINE_M)


@dataclass(frozen=True, eq=False)
class Outcomes:
    """How n trials ended."""

    depth: NDArray[np.int64]  # true class, shape (n,)
    estimate: NDArray[np.int64]  # class decided for, shape (n,)
    confidence: Float64Array  # its posterior, shape (n,)
    probes: NDArray[np.int64]  # sweeps taken, shape (n,)
    seconds: Float64Array  # duration on the rig, shape (n,)
    decided: NDArray[np.bool_]  # whether the stop rule was met, shape (n,); else undecided at the last probe
    # posterior mean depth after each probe, as it was at the stop from then on, shape (n, t)
    expected_m: Float64Array
    right: NDArray[np.bool_]  # whether the estimate was right after each probe, likewise, shape (n, t)

    @property
    def correct(self) -> NDArray[np.bool_]:
        """Whether the estimate is the true class, shape (n,)."""
        return np.asarray(self.estimate == self.depth)


def run_trials(
    trained: TrainedFeature,
    model: latent.OffsetModel,
    policy: StiffnessPolicy,
    stop: StopRule,
    *,
    timing: Timing | None = None,
) -> Outcomes:
    """Run every trial of a session to its verdict."""
    timing, session = timing or Timing(), trained.session
    slot = _slots(policy, session.rings_m)
    uniforms, fixed = session.uniforms, isinstance(policy, FixedRing)
    count, most = uniforms.shape
    rings_m, depths_m = np.asarray(session.rings_m), np.asarray(trained.depths_m)
    prior = np.full(len(depths_m), 1.0 / len(depths_m))
    active = np.arange(count)
    belief = latent.start(model, count)
    knows = isinstance(policy, InformationGainLatent) and policy.model is not model
    own = latent.start(policy.model, count) if isinstance(policy, InformationGainLatent) else belief
    at = policy.start(given(uniforms[:, 0]), count)
    end_posterior = np.tile(prior, (count, 1))
    posteriors = np.zeros((most, count, len(depths_m)))
    probes = np.zeros(count, dtype=np.int64)
    seconds, decided = np.zeros(count), np.zeros(count, dtype=bool)
    error_m, reading = np.zeros(count), np.zeros(count)
    before_ring = np.full(count, -1)
    for t in range(most):
        ring = slot[at.level]
        here = before_ring[active]
        moved = (ring != here) | at.renew
        seconds[active] += timing.sweep_s + _travel_s(timing, rings_m, here, ring, at.renew)
        landing = session.kept_landing_m[active] if fixed else session.landings_m[active, t]
        error_m[active] = np.where(moved, landing, error_m[active])
        felt = trained.reading(active, ring, error_m[active], t)
        if session.plan.conditions.same_reading:
            felt = np.where(moved, felt, reading[active])
        reading[active], before_ring[active] = felt, ring
        belief = latent.update(model, belief, felt[:, None], ring, moved)
        if knows and isinstance(policy, InformationGainLatent):
            own = latent.update(policy.model, own, felt[:, None], ring, moved)
        else:
            own = belief
        posterior = belief.posterior
        halt = stop.check(BeliefStep.over(prior, posterior, end_posterior[active], t + 1)).converged
        end_posterior[active], probes[active] = posterior, t + 1
        decided[active] = halt
        posteriors[t] = end_posterior
        going = ~halt
        if t + 1 == most or not going.any():
            posteriors[t + 1 :] = end_posterior
            break
        active, belief, own = active[going], belief[going], own[going]
        at = policy.step(at[going], own, given(uniforms[active, t + 1]))
    depth = trained.depth
    return Outcomes(
        depth,
        np.argmax(end_posterior, axis=1),
        end_posterior.max(axis=1),
        probes,
        seconds,
        decided,
        np.transpose(posteriors @ depths_m),
        np.transpose(np.argmax(posteriors, axis=2) == depth),
    )


def _slots(policy: StiffnessPolicy, trained_m: tuple[float, ...]) -> NDArray[np.int64]:
    """Return the trained setting of each level of the policy."""
    away = np.abs(np.asarray(policy.rings_m)[:, None] - np.asarray(trained_m))
    if (away.min(axis=1) > 1e-9).any():
        raise PalpError(f"the policy uses rings {policy.rings_m} m; trained are {trained_m}")
    slots: NDArray[np.int64] = np.argmin(away, axis=1)
    return slots


def _travel_s(
    timing: Timing,
    rings_m: Float64Array,
    here: NDArray[np.int64],
    ring: NDArray[np.int64],
    renew: NDArray[np.bool_] | bool = False,
) -> Float64Array:
    """Return the time of each trial's move; the first is from the stop, where one that re-homes begins."""
    first = (rings_m[ring] + timing.home_m) / timing.ring_m_per_s + timing.settle_s
    first = first if timing.rehomes else np.zeros(len(ring))
    way = np.where(renew, timing.renew_s(rings_m[ring]), timing.move_s(rings_m[here], rings_m[ring]))
    return np.where(here < 0, first, way)


def chance(trained: TrainedFeature) -> Outcomes:
    """Return the outcomes of guessing without a probe."""
    uniforms, m, depth = trained.session.uniforms, len(trained.depths_m), trained.depth
    count, most = uniforms.shape
    guess = (uniforms[:, 0] * m).astype(np.int64)
    return Outcomes(
        depth,
        guess,
        np.full(count, 1.0 / m),
        np.zeros(count, dtype=np.int64),
        np.zeros(count),
        np.ones(count, dtype=bool),
        np.full((count, most), float(np.mean(trained.depths_m))),
        np.repeat((guess == depth)[:, None], most, axis=1),
    )


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
    probes = np.zeros(count, dtype=np.int64)
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
                way = np.array([before]), np.array([setting])
                seconds[some] += _travel_s(protocol.timing, rings_m, *way)
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
    return Outcomes(session.depth, estimate, confidence, probes, seconds, decided, expected_m, right)


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
    flat = latent.of_classes(np.full((count, len(session.depths_m)), 1.0 / len(session.depths_m)))
    for probe in range(1, most):
        at = policy.step(at, flat, given(session.uniforms[:, probe]))
        found.append(slot[at.level])
    return np.stack(found, axis=1)


def _most_information(
    model: TraceModel, session: WorldSession, protocol: Protocol, belief: TraceBelief, before: int
) -> Indices:
    """Return where a whole sweep is expected to give most information per second, shape (n,)."""
    rings_m = np.asarray(session.rings_m)
    settings = np.arange(len(rings_m))
    bits = np.stack([expected_bits(model, belief, s, landed=before != s) for s in settings.tolist()], axis=1)
    here = np.full(len(settings), before)
    cost = protocol.timing.sweep_s + _travel_s(protocol.timing, rings_m, here, settings)
    return np.asarray(np.argmax(bits / cost, axis=1), dtype=np.int64)
