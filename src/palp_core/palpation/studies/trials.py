"""Decide many trials at once: probe, update, stop or go on, all policies and filters by the same lines."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PalpError
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.belief.stopping import BeliefStep, StopRule
from palp_core.palpation.perception.strategy.policies import FixedRing, StiffnessPolicy, given
from palp_core.palpation.perception.strategy.policies_informed import InformationGainLatent, Timing
from palp_core.palpation.studies.training import TrainedFeature
from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class Outcomes:
    """How n trials ended."""

    depth: NDArray[np.int64]  # true class, shape (n,)
    estimate: NDArray[np.int64]  # class decided for, shape (n,)
    confidence: Float64Array  # its posterior, shape (n,)
    probes: NDArray[np.int64]  # sweeps taken, shape (n,)
    moves: NDArray[np.int64]  # moves of the ring after the first, re-positioning included, shape (n,)
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
    probes, moves = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    seconds, decided = np.zeros(count), np.zeros(count, dtype=bool)
    error_m, reading = np.zeros(count), np.zeros(count)
    before_ring = np.full(count, -1)
    for t in range(most):
        ring = slot[at.level]
        here = before_ring[active]
        moved = (ring != here) | at.renew
        seconds[active] += timing.sweep_s + _travel_s(timing, rings_m, here, ring, at.renew)
        moves[active] += moved & (here >= 0)
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
        moves,
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
    renew: NDArray[np.bool_],
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
    none = np.zeros(count, dtype=np.int64)
    return Outcomes(
        depth,
        guess,
        np.full(count, 1.0 / m),
        none,
        none,
        np.zeros(count),
        np.ones(count, dtype=bool),
        np.full((count, most), float(np.mean(trained.depths_m))),
        np.repeat((guess == depth)[:, None], most, axis=1),
    )
