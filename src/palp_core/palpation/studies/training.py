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
    independent_model,
    latent_model,
    on_depths,
)
from palp_core.palpation.perception.belief.ring_curve import LEAST_RINGS, ring_curve
from palp_core.palpation.session.filters import height_slope
from palp_core.palpation.studies.plan import Gel
from palp_core.palpation.studies.session import Indices, WorldPlan, WorldSession, begin, feature_of
from palp_core.palpation.world.latents import latents
from palp_core.palpation.world.model import PAPER
from palp_core.units import Float64Array

_STEP_M = 5e-5
_NOISY_SWEEPS = 200


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
    if len(gel.rings_m) < 2:
        pass  # nothing tells how a reading answers to the ring
    elif noise is None:
        latent = informed_model(primitives, plan, feature)
    else:
        slope = _height_slope(gel, feature)
        if grid_m:
            grid = np.asarray(grid_m)
            primitives = primitives.interpolated(grid)
            naive = independent_model(primitives)
            slope = on_depths(slope, np.asarray(gel.depths_m), grid)
        latent = latent_model(primitives, noise, slope)
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


@functools.lru_cache(maxsize=64)
def _reading_noise(plan: WorldPlan, feature: str) -> Float64Array:
    """Return the spread of the reading that the sensor's noise makes, N m, shape (m, k)."""
    table, (depth, ring) = plan.table(plan.gel), _cells(plan)
    clean = np.repeat(table.traces(depth, ring, latents(len(depth))), _NOISY_SWEEPS, axis=0)
    luck = np.random.default_rng(20).standard_normal((len(clean), 2 * clean.shape[1] + 2))
    noise_sd_n_m = plan.gel.noise_factor * RESOLUTION_N_M
    noisy = feature_of(feature, clean + table.sensor(PAPER, luck, noise_sd_n_m=noise_sd_n_m))
    return np.asarray(noisy.reshape(len(plan.gel.depths_m), -1, _NOISY_SWEEPS).std(axis=2, ddof=1))


def _cells(plan: WorldPlan) -> tuple[NDArray[np.int64], ...]:
    depth, ring = np.indices((len(plan.gel.depths_m), len(plan.gel.rings_m)))
    return depth.ravel(), ring.ravel()


def informed_model(primitives: Primitives, plan: WorldPlan, feature: str) -> OffsetModel:
    """Return primitives that know what stays.

    Offsets: the ring's landing (until it moves), the height (for the trial), and the error that training left
    in each depth's mean (for the trial; its landings were as few as they were). Means lie on a curve over the
    ring through the session's own, where there are rings enough and the cells do not contradict it. Known
    from the rig, not from this session: the spreads of landing and height, the sensor's noise, and how a
    reading answers to both offsets. A height counts against that of the training's mounting, hence its
    variance twice; against their mean where training had many.
    """
    mean, rings_m, conditions = primitives.mean, primitives.rings_m, plan.conditions
    landings = conditions.training if conditions.training_lands == "each" else 1
    (ring, height), sd = reading_slopes(plan, feature), conditions.ring_sd_m
    noise = _reading_noise(plan, feature) ** 2 + primitives.floor**2
    error_sd = np.sqrt((ring * sd) ** 2 / landings + noise / conditions.training)
    curve = ring_curve(mean, error_sd, rings_m) if len(rings_m) >= LEAST_RINGS else None
    if curve is not None and curve.fits:
        mean, root = curve.mean, curve.root
    else:
        root = error_sd[..., None] * np.eye(len(rings_m))
    slope = np.concatenate([np.stack([ring, height], axis=-1), root], axis=-1)[:, :, None, :]
    height_sd = np.sqrt(1.0 + 1.0 / conditions.training_mounts) * conditions.height_sd_m
    left = root.shape[-1]
    offset_sd = np.array([sd, height_sd, *[1.0] * left])
    return OffsetModel(
        mean[..., None], noise[..., None, None], slope, offset_sd, (True, *[False] * (1 + left))
    )
