"""The filter of what stays between readings, and what it is made of: memory primitives and a rig's noise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal, norm

from palp_core.errors import PerceptionError
from palp_core.methods import find
from palp_core.palpation.perception.belief import bayes, latent
from palp_core.palpation.perception.belief.latent import OffsetModel
from palp_core.palpation.perception.belief.primitives import Primitives, fit
from palp_core.palpation.perception.belief.rig_noise import assumed_noise, latent_model, ring_slopes

RING_SD, HEIGHT_SD = 0.17, 0.1
seeds = st.integers(0, 10_000)


def model(seed: int, m: int = 3, k: int = 4, f: int = 1) -> OffsetModel:
    """Return random primitives with a ring error per position and a height per trial."""
    rng = np.random.default_rng(seed)
    root = rng.normal(0, 0.3, (m, k, f, f))
    noise = root @ np.swapaxes(root, -1, -2) + 0.05 * np.eye(f)
    return OffsetModel(
        rng.normal(0, 2, (m, k, f)),
        noise,
        rng.normal(0, 3, (m, k, f, 2)),
        np.array([RING_SD, HEIGHT_SD]),
        (True, False),
    )


def filtered(
    given_model: OffsetModel, readings: np.ndarray, places: list[int], moves: list[bool]
) -> latent.Belief:
    belief = latent.start(given_model)
    for reading, place, moved in zip(readings, places, moves, strict=True):
        belief = latent.update(given_model, belief, reading, place, moved)
    return belief


def joint_posterior(
    given_model: OffsetModel, readings: np.ndarray, places: list[int], moves: list[bool]
) -> np.ndarray:
    """Return the posterior from the joint normal of all readings: no recursion."""
    position = np.cumsum([False, *moves[1:]])
    count, f = readings.shape
    logs = []
    for d in range(len(given_model.mean)):
        centre = np.concatenate([given_model.mean[d, k] for k in places])
        cov = np.zeros((count * f, count * f))
        for i, a in enumerate(places):
            for j, b in enumerate(places):
                slope_a, slope_b = given_model.slope[d, a], given_model.slope[d, b]
                block = HEIGHT_SD**2 * np.outer(slope_a[:, 1], slope_b[:, 1])
                if position[i] == position[j]:
                    block = block + RING_SD**2 * np.outer(slope_a[:, 0], slope_b[:, 0])
                if i == j:
                    block = block + given_model.noise[d, a]
                cov[i * f : (i + 1) * f, j * f : (j + 1) * f] = block
        logs.append(multivariate_normal(centre, cov).logpdf(readings.ravel()))
    return bayes.posterior(np.array(logs))


@given(seeds, st.integers(1, 5), st.integers(1, 2))
@settings(max_examples=25, deadline=None)
def test_the_filter_is_the_joint_normal_of_all_readings(seed: int, count: int, features: int) -> None:
    rng = np.random.default_rng(seed + 1)
    one = model(seed, f=features)
    places, moves = rng.integers(0, 4, count).tolist(), [bool(b) for b in rng.random(count) < 0.5]
    readings = rng.normal(0, 2, (count, features))
    assert filtered(one, readings, places, moves).posterior == pytest.approx(
        joint_posterior(one, readings, places, moves), abs=1e-9
    )


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_without_offsets_it_is_eq_7(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one = find("filter", "naive").target(model(seed))
    log_belief, belief = bayes.flat_prior(3), latent.start(one)
    for place in rng.integers(0, 4, 4).tolist():
        reading = float(rng.normal(0, 2))
        cell = norm(one.mean[:, place, 0], np.sqrt(one.noise[:, place, 0, 0]))
        log_belief = bayes.update(log_belief, cell.logpdf(reading))
        belief = latent.update(one, belief, reading, place, bool(rng.random() < 0.5))
    assert belief.posterior == pytest.approx(bayes.posterior(log_belief), abs=1e-12)


def test_equal_readings_that_share_their_error_convince_less_than_independent_ones() -> None:
    one = OffsetModel(
        np.array([[[0.0]], [[1.0]]]),
        np.full((2, 1, 1, 1), 1e-4),
        np.ones((2, 1, 1, 1)),
        np.array([1.0]),
        (True,),
    )
    readings = np.full((20, 1), 0.2)
    stays = filtered(one, readings, [0] * 20, [False] * 20).posterior
    believes = filtered(latent.naive(one), readings, [0] * 20, [False] * 20).posterior
    moves = filtered(one, readings, [0] * 20, [True] * 20).posterior
    assert believes.max() == pytest.approx(moves.max(), abs=1e-9)
    assert stays.max() < 0.6 < 0.99 < moves.max()


@given(seeds, st.integers(2, 6))
@settings(max_examples=10, deadline=None)
def test_a_batch_is_its_trials_one_by_one(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    one = model(seed, f=2)
    places, moves = rng.integers(0, 4, (3, count)), rng.random((3, count)) < 0.5
    readings = rng.normal(0, 2, (3, count, 2))
    batch = latent.start(one, count)
    for t in range(3):
        batch = latent.update(one, batch, readings[t], places[t], moves[t])
    for n in range(count):
        alone = filtered(one, readings[:, n], places[:, n].tolist(), moves[:, n].tolist())
        assert batch.posterior[n] == pytest.approx(alone.posterior, abs=1e-9)
        assert batch.offset_cov[n] == pytest.approx(alone.offset_cov, abs=1e-12)


def test_an_impossible_reading_leaves_a_belief() -> None:
    belief = filtered(model(0), np.array([[1e6]]), [0], [True])
    assert belief.posterior.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("reading", [np.nan, np.inf, [1.0, 2.0]])
def test_a_reading_that_is_none_is_refused(reading: float | list[float]) -> None:
    one = model(0)
    with pytest.raises(PerceptionError, match="reading"):
        latent.update(one, latent.start(one), reading, 0, True)


def test_an_untrained_setting_is_refused() -> None:
    one = model(0)
    with pytest.raises(PerceptionError, match="was not trained; there are 4"):
        latent.update(one, latent.start(one), 0.0, 4, True)


def test_a_model_that_cannot_be_is_refused() -> None:
    good = model(0)
    with pytest.raises(PerceptionError, match="not positive definite"):
        OffsetModel(good.mean, 0.0 * good.noise, good.slope, good.offset_sd, good.renewed_by_move)
    with pytest.raises(PerceptionError, match="one flag"):
        OffsetModel(good.mean, good.noise, good.slope, good.offset_sd, (True,))


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
