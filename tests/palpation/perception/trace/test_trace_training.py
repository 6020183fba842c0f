"""Bins, textures and what training sweeps teach."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.trace.bins import BinnedSweep, PositionBins
from palp_core.palpation.perception.trace.texture import Texture, fit_texture
from palp_core.palpation.perception.trace.training import learn, shrunk_covariance, sticking

PATH = PositionBins.over(-0.03, 0.05, 0.002)
MIDDLE_M = np.asarray(-0.03 + 0.002 * (np.arange(PATH.count) + 0.5), dtype=np.float64)


@given(st.lists(st.integers(0, 4000), max_size=8), st.booleans())
def test_blocks_give_the_bins_of_the_whole(cuts: list[int], backward: bool) -> None:
    position = np.asarray(-0.03 + 2e-5 * np.arange(4000), dtype=np.float64)
    bins = PATH
    if backward:
        position, bins = position[::-1], PositionBins.over(position[-1], -0.03, 0.002)
    torque = np.sin(position * 300.0) + 0.01 * np.random.default_rng(1).standard_normal(4000)
    whole, sweep = BinnedSweep(), BinnedSweep()
    whole.add(bins, position, torque)
    whole.finish(bins)
    ends = [0, *sorted(cuts), 4000]
    for low, high in itertools.pairwise(ends):
        sweep.add(bins, position[low:high], torque[low:high])
    sweep.finish(bins)
    assert whole.done == sweep.done
    assert len(whole.done) == bins.count
    index = bins.index(position)
    np.testing.assert_allclose(whole.done, [torque[index == b].mean() for b in range(bins.count)], rtol=1e-12)


def test_a_bin_without_a_sample_lies_between_its_neighbours() -> None:
    sweep = BinnedSweep()
    sweep.add(PATH, np.array([-0.0299, -0.0285, -0.0235]), np.array([1.0, 3.0, 5.0]))
    assert sweep.done == [2.0, 4.0, 4.0]


def test_bad_bins_and_samples_are_refused() -> None:
    for wrong in ((0.0, 0.0, 3), (0.0, np.nan, 3), (0.0, 0.002, 0)):
        with pytest.raises(PerceptionError):
            PositionBins(*wrong)
    with pytest.raises(PerceptionError, match="NaN"):
        BinnedSweep().add(PATH, np.array([0.0]), np.array([np.nan]))
    with pytest.raises(PerceptionError, match="2 positions for 1"):
        BinnedSweep().add(PATH, np.array([0.0, 0.1]), np.array([0.0]))


@pytest.mark.parametrize(
    ("form", "sd_n_m", "length_m"), [("exponential", 1.9896e-4, 4.734e-3), ("gaussian", 1.9522e-4, 5.016e-3)]
)
def test_the_texture_of_residuals_is_found_again(form: str, sd_n_m: float, length_m: float) -> None:
    """What 30 rows tell of a spread of 2e-4 and a length of 5e-3."""
    rng, true = np.random.default_rng(2), Texture(2e-4, 5e-3, form)
    place = MIDDLE_M
    slope = np.broadcast_to(np.cos(place * 60.0)[:, None], (30, len(place), 1))
    covariance = true.covariance(place, place) + 1e-10 * np.eye(len(place))
    rows = rng.multivariate_normal(np.zeros(len(place)), covariance, 30)
    rows += slope[:, :, 0] * rng.normal(0.0, 1e-3, (30, 1))
    found = fit_texture(rows, slope, np.array([1e-3]), 1e-10 * np.eye(len(place)), np.tile(place, (30, 1)))
    assert found.form == form
    assert (found.sd_n_m, found.length_m) == pytest.approx((sd_n_m, length_m), rel=2e-3)


def test_training_teaches_the_mean_of_mountings_and_the_scatter_without_the_landing() -> None:
    rng = np.random.default_rng(3)
    place = MIDDLE_M
    shape = np.exp(-((place / 0.01) ** 2))
    depths, rings = (0.002, 0.004), (0.0, 0.004, 0.008)
    rows, depth, ring, mounting = [], [], [], []
    for d in depths:
        for mount in range(3):
            height = rng.normal(0.0, 1e-4)
            for r in rings:
                for _ in range(20):
                    landed = r + rng.normal(0.0, 1.7e-4)
                    signal = (0.1 / (1.0 + 1e3 * d)) * landed * shape + height * shape
                    rows.append(signal + rng.normal(0.0, 2e-6, len(place)))
                    depth.append(d)
                    ring.append(r)
                    mounting.append(mount + int(1e4 * d))
    learnt = learn(np.array(rows), depth, ring, mounting, floor_n_m=1e-9)
    noise = np.diagonal(learnt.scatter, axis1=1, axis2=2)
    np.testing.assert_allclose(noise.mean(axis=1), 4e-12, rtol=0.1)
    off = learnt.scatter - noise[:, :, None] * np.eye(PATH.count)
    assert np.abs(off).max() < 1e-12
    assert learnt.mountings.tolist() == [3, 3]
    assert learnt.landings.tolist() == [[60] * 3] * 2
    assert learnt.between.shape == (6, 3, PATH.count)
    wanted = np.array([[(0.1 / (1.0 + 1e3 * d)) * r * shape for r in rings] for d in depths])
    np.testing.assert_allclose(learnt.mean, wanted, atol=3e-4)
    steep = np.array([0.1 / (1.0 + 1e3 * d) for d in depths])[:, None, None] * shape
    np.testing.assert_allclose(learnt.ring_slope, np.broadcast_to(steep, learnt.mean.shape), atol=2e-3)


def test_a_cell_without_a_sweep_is_named() -> None:
    with pytest.raises(PerceptionError, match="depth 4 mm and ring 8 mm"):
        learn(np.zeros((3, 5)), [0.002, 0.002, 0.004], [0.004, 0.008, 0.004], [1, 1, 2], floor_n_m=1e-6)


def test_a_covariance_of_few_rows_keeps_what_is_no_chance() -> None:
    rng = np.random.default_rng(8)
    true = 0.9 ** np.abs(np.subtract.outer(np.arange(20), np.arange(20)))
    plain, drawn = [], []
    for _ in range(20):
        rows = rng.multivariate_normal(np.zeros(20), true, 30)
        rows = rows - rows.mean(axis=0)
        plain.append(np.linalg.norm(rows.T @ rows / 29 - true))
        drawn.append(np.linalg.norm(shrunk_covariance(rows, 29) - true))
    assert np.mean(drawn) < np.mean(plain)
    white = shrunk_covariance(rng.standard_normal((40, 20)), 40)
    assert np.abs(white - np.diag(np.diag(white))).max() < 0.1
    assert np.linalg.eigvalsh(shrunk_covariance(rng.standard_normal((5, 20)), 5)).min() > 0.0


def test_bins_in_which_a_tip_may_stick_are_not_read() -> None:
    place = np.concatenate([-0.03 + 1e-4 * np.arange(8), -0.028 + 2e-3 * np.arange(22)])
    held = sticking(np.tile(place, (2, 3, 1)))
    assert held.shape == (3, 30)
    assert held[0].tolist() == [True] * 9 + [False] * 21  # seven, and a quarter more
    assert not sticking(np.tile(MIDDLE_M, (2, 3, 1))).any()
