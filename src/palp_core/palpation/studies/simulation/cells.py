"""What a feature is in each cell of depth and ring, and the filter that is handed it."""

import functools

import numpy as np

from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.latent import OffsetModel
from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.palpation.perception.belief.ring_curve import LEAST_RINGS, ring_curve
from palp_core.palpation.studies.simulation.features import feature_of
from palp_core.palpation.studies.simulation.session import WorldPlan
from palp_core.palpation.world.latents import latents
from palp_core.palpation.world.model import PAPER
from palp_core.units import Float64Array

_STEP_M = 5e-5
_NOISY_SWEEPS = 200


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
def reading_noise(plan: WorldPlan, feature: str) -> Float64Array:
    """Return the spread of the reading that the sensor's noise makes, N m, shape (m, k)."""
    table, (depth, ring) = plan.table(plan.gel), _cells(plan)
    clean = np.repeat(table.traces(depth, ring, latents(len(depth))), _NOISY_SWEEPS, axis=0)
    luck = np.random.default_rng(20).standard_normal((len(clean), 2 * clean.shape[1] + 2))
    noise_sd_n_m = plan.gel.noise_factor * RESOLUTION_N_M
    noisy = feature_of(feature, clean + table.sensor(PAPER, luck, noise_sd_n_m=noise_sd_n_m))
    return np.asarray(noisy.reshape(len(plan.gel.depths_m), -1, _NOISY_SWEEPS).std(axis=2, ddof=1))


def _cells(plan: WorldPlan) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], ...]:
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
    noise = reading_noise(plan, feature) ** 2 + primitives.floor**2
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
