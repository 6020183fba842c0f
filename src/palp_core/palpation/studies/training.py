"""What a session's training leaves to decisions by one feature: primitives, filters, and the best ring."""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.latent import OffsetModel
from palp_core.palpation.perception.belief.primitives import Primitives, fit, quantisation_sd
from palp_core.palpation.perception.belief.rig_noise import (
    RigNoise,
    assumed_noise,
    independent_model,
    latent_model,
    on_depths,
)
from palp_core.palpation.session.filters import height_slope
from palp_core.palpation.studies.plan import Gel
from palp_core.palpation.studies.session import Indices, WorldPlan, WorldSession, begin, feature_of
from palp_core.palpation.world.latents import latents
from palp_core.units import Float64Array

_STEP_M = 5e-5


@dataclass(frozen=True, eq=False)
class TrainedFeature:
    """A session whose sweeps are read as one number each."""

    session: WorldSession  # the session
    feature: str  # peak or contrast
    depths_m: tuple[float, ...]  # depths to decide among
    primitives: Primitives  # fitted to the readings of training
    best_ring: int  # index of the position whose single readings are best decided within training
    naive: OffsetModel  # the paper's filter
    latent: OffsetModel  # the one that knows what stays

    @property
    def best_ring_m(self) -> float:
        """Position whose single readings are best decided within training."""
        return self.session.rings_m[self.best_ring]

    @property
    def depth(self) -> Indices:
        """True class of each trial among ``depths_m``, shape (n,)."""
        return nearest(np.asarray(self.session.depths_m), np.asarray(self.depths_m))[self.session.depth]

    def reading(self, trials: Indices, ring: Indices, error_m: Float64Array, probe: int) -> Float64Array:
        """Return the reading of a probe, N m."""
        return feature_of(self.feature, self.session.traces(trials, ring, error_m, probe))


def nearest(values: Float64Array, among: Float64Array) -> NDArray[np.int64]:
    """Return the index of what is nearest among others to each value."""
    return np.asarray(np.abs(values[:, None] - among).argmin(axis=1), dtype=np.int64)


def train_feature(
    session: WorldSession, feature: str, *, grid_m: tuple[float, ...] = (), noise: RigNoise | None = None
) -> TrainedFeature:
    """Return what training leaves, as the estimator on a rig has it: from its readings and a scene file."""
    training, plan = session.training, session.plan
    gel, readings = plan.gel, feature_of(feature, training.traces)
    primitives = fit(
        readings,
        training.depth.tolist(),
        training.ring.tolist(),
        depths_m=gel.depths_m,
        rings_m=gel.rings_m,
        floor=quantisation_sd(RESOLUTION_N_M),
    )
    best = best_ring(readings.reshape(len(gel.depths_m), len(gel.rings_m), -1))
    naive = latent = independent_model(primitives)
    if len(gel.rings_m) > 1:  # one ring does not show how a reading answers to it
        slope = _height_slope(gel, feature)
        if grid_m:
            grid = np.asarray(grid_m)
            primitives = primitives.interpolated(grid)
            naive = independent_model(primitives)
            slope = on_depths(slope, np.asarray(gel.depths_m), grid)
        usual = assumed_noise(plan.conditions.ring_sd_m, plan.conditions.height_sd_m)
        latent = latent_model(primitives, noise or usual, slope)
    return TrainedFeature(session, feature, grid_m or session.depths_m, primitives, best, naive, latent)


@functools.lru_cache(maxsize=64)
def _height_slope(gel: Gel, feature: str) -> Float64Array:
    return height_slope(gel.depths_m, gel.rings_m, feature, gel.scene(gel.depths_m[0]))


def begin_trained(plan: WorldPlan, seed: tuple[int, ...]) -> TrainedFeature:
    """Draw a session, and return what its training leaves to decisions by its gel's feature."""
    return train_feature(begin(plan, seed), plan.gel.reading)


def best_ring(readings: Float64Array) -> int:
    """Return the ring position whose single readings are best decided, by leaving out one palpation a cell.

    Returns:
        Index of the position; of equals, the one with the largest mean log posterior.
    """
    count = readings.shape[2]
    total = readings.sum(axis=2, keepdims=True)
    mean = (total - readings) / (count - 1)  # without the palpation itself, (m, k, n)
    squares = (readings**2).sum(axis=2, keepdims=True) - readings**2
    variance = np.maximum(squares - (count - 1) * mean**2, 0.0) / max(count - 2, 1) + 1e-12
    # palpation n of class c against class d; only d = c is without it, which is what matters least for d != c
    z = readings[:, None] - mean[None]
    log = -0.5 * z**2 / variance[None] - 0.5 * np.log(variance)[None]  # (c, d, k, n)
    own = np.einsum("cckn->ckn", log)
    top = log.max(axis=1)
    share = (own >= top).mean(axis=(0, 2))
    sure = (own - np.log(np.exp(log - top[:, None]).sum(axis=1)) - top).mean(axis=(0, 2))
    return int(np.lexsort((sure, share))[-1])


@functools.lru_cache(maxsize=64)
def cell_readings(plan: WorldPlan, feature: str, ring_m: float = 0.0, height_m: float = 0.0) -> Float64Array:
    """Return true readings, N m, shape (m, k), with the ring or the surface off nominal."""
    table, (depth, ring) = plan.table(plan.gel), _cells(plan)
    traces = table.traces(depth, ring, latents(len(depth), ring_m=ring_m, height_m=height_m))
    return feature_of(feature, traces).reshape(len(plan.gel.depths_m), -1)


def reading_slopes(plan: WorldPlan, feature: str) -> tuple[Float64Array, Float64Array]:
    """Return the change of the reading per metre of ring error and of height, N, shape (m, k) each."""
    ring = cell_readings(plan, feature, _STEP_M) - cell_readings(plan, feature, -_STEP_M)
    height = cell_readings(plan, feature, 0.0, _STEP_M) - cell_readings(plan, feature, 0.0, -_STEP_M)
    return ring / (2.0 * _STEP_M), height / (2.0 * _STEP_M)


def _cells(plan: WorldPlan) -> tuple[NDArray[np.int64], ...]:
    depth, ring = np.indices((len(plan.gel.depths_m), len(plan.gel.rings_m)))
    return depth.ravel(), ring.ravel()
