"""Trials decided by whole traces, bin by bin or sweep by sweep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

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
from palp_core.palpation.perception.trace.training import TrainedTraces, learn
from palp_core.palpation.session.trace_settings import TraceSettings
from palp_core.palpation.studies.frontier.protocols import Protocol
from palp_core.palpation.studies.simulation.session import FINE_M, WorldSession
from palp_core.palpation.studies.simulation.trials import Outcomes
from palp_core.units import Float64Array

BIN_M = 0.002
MOST = 6
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


def learnt_of(session: WorldSession, settings: TraceSettings) -> TrainedTraces:
    """Return what the session's training teaches."""
    training, gel = session.training, session.plan.gel
    return learn(
        coarse(training.traces),
        np.asarray(gel.depths_m)[training.depth].tolist(),
        np.asarray(gel.rings_m)[training.ring].tolist(),
        training.mounting.tolist(),
        floor_n_m=settings.floor_n_m,
    )


def model_of(
    session: WorldSession, settings: TraceSettings, trace_filter: str = "second_order"
) -> TraceModel:
    """Return the trace filter's model after the session's training, by the nominal scene."""
    gel = session.plan.gel
    scene = gel.scene(gel.depths_m[0], "trace")
    return settings.model(learnt_of(session, settings), scene=scene, trace_filter=trace_filter)


@dataclass(frozen=True, eq=False)
class TraceOutcomes:
    """How trials ended that were decided by their traces.

    Attributes:
        ended: As of any trials.
        way_m: Way swept in the last sweep, shape (n,).
    """

    ended: Outcomes
    way_m: Float64Array


def run_trace_trials(
    session: WorldSession,
    model: TraceModel,
    protocol: Protocol,
    *,
    selector: RingSelector,
    threshold: float = 0.99,
    stop: StopRule | None = None,
    most: int = MOST,
    grid_m: tuple[float, ...] = (),
) -> TraceOutcomes:
    """Run every trial to its verdict."""
    rings_m, depths_m = np.asarray(session.rings_m), np.asarray(grid_m or session.depths_m)
    count, m = len(session.depth), model.class_count
    end = np.full((count, m), 1.0 / m)
    probes, moves = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    seconds, decided = np.zeros(count), np.zeros(count, dtype=bool)
    way = np.zeros(count)
    error_m = np.zeros(count)
    groups: list[tuple[NDArray[np.int64], TraceBelief, int]] = [(np.arange(count), start(model, count), -1)]
    for t in range(most):
        following: list[tuple[NDArray[np.int64], TraceBelief, int]] = []
        for trials, belief, before in groups:
            asked = selector(model, belief, trials, before, t)
            for setting in np.unique(asked):
                here = asked == setting
                some, known = trials[here], belief[here]
                moved = before != setting
                seconds[some] += _travel_s(protocol, rings_m, before, int(setting))
                moves[some] += int(moved and before >= 0)
                if moved:
                    error_m[some] = (
                        session.kept_landing_m[some] if selector.stays else session.landings_m[some, t]
                    )
                known = begin_sweep(known, int(setting), landed=bool(moved))
                felt = coarse(session.traces(some, np.full(len(some), setting), error_m[some], t))
                after, posterior = observe_stepwise(model, known, felt)
                if stop is None:
                    sure = posterior.max(axis=2) >= threshold
                else:
                    sure = _whole_sweeps(stop, posterior, end[some], t + 1)
                if not protocol.in_sweep:
                    sure[:, :-1] = False
                halt, last = first_sure(sure)
                end[some] = posterior[np.arange(len(some)), last]
                probes[some], decided[some] = t + 1, halt
                way[some] = (last + 1) * BIN_M
                seconds[some] += protocol.sweep_s(way[some]) + protocol.back_s(way[some])
                if (~halt).any():
                    following.append((some[~halt], after[~halt], int(setting)))
        groups = following
        if not groups:
            break
    ended = outcomes(session, depths_m, end, probes, moves, seconds, decided)
    return TraceOutcomes(ended, way)


def first_sure(sure: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Return whether trials end within a sweep and after which bin, else its last; from shape (n, bins)."""
    halt = np.asarray(sure.any(axis=1))
    return halt, np.asarray(np.where(halt, np.argmax(sure, axis=1), sure.shape[1] - 1))


def outcomes(
    session: WorldSession,
    depths_m: Float64Array,
    end: Float64Array,
    probes: NDArray[np.int64],
    moves: NDArray[np.int64],
    seconds: Float64Array,
    decided: NDArray[np.bool_],
) -> Outcomes:
    """Return how trials ended, by their last belief; the estimate is the session's depth nearest to it.

    Args:
        session: The trials.
        depths_m: Of the belief's classes, shape (m,).
        end: Last belief, shape (n, m).
        probes: As of :class:`Outcomes`, like what follows.
        moves: Likewise.
        seconds: Likewise.
        decided: Likewise.
    """
    estimate = nearest(depths_m, np.asarray(session.depths_m))[np.argmax(end, axis=1)]
    return Outcomes(
        session.depth,
        estimate,
        end.max(axis=1),
        probes,
        moves,
        seconds,
        decided,
        (end @ depths_m)[:, None],
        (estimate == session.depth)[:, None],
    )


def _whole_sweeps(
    stop: StopRule, posterior: Float64Array, before: Float64Array, probes: int
) -> NDArray[np.bool_]:
    """Return where a rule ends trials, shape (n, bins): after a sweep's last bin only."""
    found = np.zeros(posterior.shape[:2], dtype=bool)
    flat = np.full(before.shape[1], 1.0 / before.shape[1])
    found[:, -1] = stop.check(BeliefStep.over(flat, posterior[:, -1], before, probes)).converged
    return found


@dataclass(frozen=True)
class KeepRing:
    """Always the same position.

    Attributes:
        ring: Its index.
    """

    ring: int
    stays: ClassVar[bool] = True

    def __call__(
        self, model: TraceModel, belief: TraceBelief, trials: NDArray[np.int64], before: int, probe: int
    ) -> NDArray[np.int64]:
        return np.full(len(trials), self.ring)


@dataclass(frozen=True, eq=False)
class DrawnRings:
    """Positions drawn by a policy that goes by chance alone, drawn before: shape (n, t), by index."""

    rings: NDArray[np.int64]
    stays: ClassVar[bool] = False

    def __call__(
        self, model: TraceModel, belief: TraceBelief, trials: NDArray[np.int64], before: int, probe: int
    ) -> NDArray[np.int64]:
        return np.asarray(self.rings[trials, probe])


@dataclass(frozen=True, eq=False)
class MostInformation:
    """Where a whole sweep is expected to tell most about the class a second.

    Attributes:
        rings_m: Positions of the ring.
        protocol: How long a sweep and the way to it take.
    """

    rings_m: tuple[float, ...]
    protocol: Protocol
    stays: ClassVar[bool] = False

    def __call__(
        self, model: TraceModel, belief: TraceBelief, trials: NDArray[np.int64], before: int, probe: int
    ) -> NDArray[np.int64]:
        settings = range(len(self.rings_m))
        bits = np.stack([expected_bits(model, belief, s, landed=before != s) for s in settings], axis=1)
        rings = np.asarray(self.rings_m)
        sweep_s = self.protocol.timing.sweep_s
        cost = np.array([sweep_s + _travel_s(self.protocol, rings, before, s) for s in settings])
        return np.asarray(np.argmax(bits / cost, axis=1), dtype=np.int64)


RingSelector = KeepRing | DrawnRings | MostInformation


def draw_rings(policy: StiffnessPolicy, session: WorldSession) -> DrawnRings:
    """Return what a policy that goes by chance alone asks in each trial."""
    count, most = session.uniforms.shape
    slot = nearest(np.asarray(policy.rings_m), np.asarray(session.rings_m))
    at = policy.start(given(session.uniforms[:, 0]), count)
    found = [slot[at.level]]
    flat = of_classes(np.full((count, len(session.depths_m)), 1.0 / len(session.depths_m)))
    for probe in range(1, most):
        at = policy.step(at, flat, given(session.uniforms[:, probe]))
        found.append(slot[at.level])
    return DrawnRings(np.stack(found, axis=1))


def nearest(values: Float64Array, among: Float64Array) -> NDArray[np.int64]:
    """Return the index of what is nearest among others to each value."""
    return np.asarray(np.abs(values[:, None] - among).argmin(axis=1), dtype=np.int64)


def _travel_s(protocol: Protocol, rings_m: Float64Array, before: int, setting: int) -> float:
    timing = protocol.timing
    if before < 0:
        return (
            float((rings_m[setting] + timing.home_m) / timing.ring_m_per_s + timing.settle_s)
            if protocol.rehome
            else 0.0
        )
    return float(timing.move_s(rings_m[before], rings_m[setting]))
