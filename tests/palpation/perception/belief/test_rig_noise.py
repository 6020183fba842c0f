"""What stays between readings, made of memory primitives and a rig's noise."""

import numpy as np
import pytest

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief import latent
from palp_core.palpation.perception.belief.primitives import Primitives, fit
from palp_core.palpation.perception.belief.rig_noise import assumed_noise, latent_model, ring_slopes

RINGS_M = np.array([0.0, 0.004, 0.008, 0.012, 0.016])
STRENGTH = np.array([60.0, 120.0, 180.0])  # N m per m^2 of ring, by class
RING_SD_M, OWN_SD = 2e-4, 2e-5
COUNT, FLOOR = 25, 1e-6


def trained(rng: np.random.Generator) -> Primitives:
    """Return primitives of readings that follow where the ring landed, and noise of their own."""
    shape = (3, len(RINGS_M), COUNT)
    landed_m = RINGS_M[None, :, None] + RING_SD_M * rng.standard_normal(shape)
    readings = STRENGTH[:, None, None] * landed_m**2 + OWN_SD * rng.standard_normal(shape)
    depth, ring, _ = (index.ravel().tolist() for index in np.indices(shape))
    depths_m = (0.002, 0.004, 0.008)
    return fit(readings.ravel(), depth, ring, depths_m=depths_m, rings_m=RINGS_M.tolist(), floor=FLOOR)


def model_of(primitives: Primitives) -> latent.OffsetModel:
    return latent_model(primitives, assumed_noise(RING_SD_M, 0.0), np.zeros((3, len(RINGS_M))))


def test_a_class_is_not_trusted_because_its_training_happened_to_scatter_little() -> None:
    found = [np.sqrt(model_of(trained(np.random.default_rng(seed))).noise[..., 0, 0]) for seed in range(20)]
    least = np.array([own_sd.min() for own_sd in found]) / OWN_SD
    assert (least.mean(), least.min()) == pytest.approx((1.0476, 0.8411), abs=1e-4)
    assert np.mean([own_sd < 1.5 * own_sd.min() for own_sd in found]) > 0.95


def test_readings_that_share_a_landing_are_decided_with_the_confidence_that_they_deserve() -> None:
    rng = np.random.default_rng(5)
    right, stated = [], []
    for _ in range(60):
        model = model_of(trained(rng))
        truth = int(rng.integers(3))
        landing_m = RING_SD_M * rng.standard_normal()
        belief = latent.start(model)
        for probe in range(5):
            reading = STRENGTH[truth] * (RINGS_M[2] + landing_m) ** 2 + OWN_SD * rng.standard_normal()
            belief = latent.update(model, belief, reading, 2, probe == 0)
        right.append(int(np.argmax(belief.posterior)) == truth)
        stated.append(float(belief.posterior.max()))
    assert np.mean(right) > 0.95
    assert np.mean(stated) - np.mean(right) < 0.05


def test_what_a_cell_scattered_beyond_chance_is_kept() -> None:
    primitives = trained(np.random.default_rng(1))
    sd = primitives.sd.copy()
    sd[2, 2] = 5e-3  # ten times the ring's part
    wild = Primitives(primitives.depths_m, primitives.rings_m, primitives.mean, sd, primitives.count, FLOOR)
    own = model_of(wild).noise[..., 0, 0]
    assert own[2, 2] > 0.5 * sd[2, 2] ** 2
    assert own[0, 0] < 10.0 * OWN_SD**2


def test_slopes_of_a_straight_line_are_its_slope() -> None:
    assert ring_slopes(1.5 * RINGS_M[None], RINGS_M) == pytest.approx(np.full((1, 5), 1.5))


def test_one_ring_position_has_no_slope() -> None:
    with pytest.raises(PerceptionError, match="needs two"):
        ring_slopes(np.zeros((3, 1)), RINGS_M[:1])
