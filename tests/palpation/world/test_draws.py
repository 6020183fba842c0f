"""Draws at each level: fixed numbers of draws, spreads as the world says, a texture as long as it says."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.world import latent_spread
from palp_core.palpation.mechanics import Bead, Phantom, Probe
from palp_core.palpation.world.draws import (
    SessionDraws,
    layer_weight,
    mounting_parts,
    parts_of,
    session_part,
    specimen_parts,
    together,
    wear_part,
)
from palp_core.palpation.world.latents import LATENTS
from palp_core.palpation.world.model import LAB, PAPER, WorldModel
from palp_core.palpation.world.texture import bias, texture, texture_map, track, white_sd_n_m


def everything(world: WorldModel, rng: np.random.Generator) -> np.ndarray:
    """Latents of one sweep, all levels drawn, and the generator's next number."""
    row = together(
        session_part(world, rng), specimen_parts(world, rng, 0.004), mounting_parts(world, rng, 1, 0.1e-3)[0]
    )
    track(rng, 1)
    return np.append(row, rng.random())


def test_worlds_differ_by_their_parameters_alone() -> None:
    """As many numbers are drawn whatever is on, and twice the spread is twice the same luck."""
    twice = replace(LAB, modulus_batch_sd=2 * LAB.modulus_batch_sd, friction_mounting_sd=0.1)
    rows = [everything(world, np.random.default_rng(4)) for world in (PAPER, LAB, twice)]
    assert rows[0][-1] == rows[1][-1] == rows[2][-1]
    named = [dict(zip(LATENTS, row[:-1], strict=True)) for row in rows]
    assert [name for name, value in named[0].items() if value] == ["height_m"]
    assert named[2]["friction"] == pytest.approx(2 * named[1]["friction"])
    assert named[2]["along_m"] == named[1]["along_m"]


def test_spreads_are_those_of_the_world() -> None:
    rng, count = np.random.default_rng(5), 12_000
    rows = together(
        np.array([session_part(LAB, rng) for _ in range(count)]),
        specimen_parts(LAB, rng, np.full(count, 0.004)),
        mounting_parts(LAB, rng, count, 0.1e-3),
        parts_of(ring_m=0.1e-3 * rng.standard_normal(count)),
    )
    mean, sd = latent_spread(LAB, 0.004, ring_sd_m=0.1e-3, height_sd_m=0.1e-3)
    np.testing.assert_allclose(rows.std(axis=0), sd, rtol=0.04)
    np.testing.assert_allclose(rows.mean(axis=0), mean, atol=0.03 * sd.max())
    assert rows[:, LATENTS.index("beside_m2")].mean() == pytest.approx(mean[5], rel=0.04)


def test_a_layer_counts_the_more_the_thicker_it_is() -> None:
    """Its limits are known: nothing of no layer, all of a deep one; at x = 1 by hand."""
    weights = [layer_weight(depth_m, 0.0035) for depth_m in (1e-7, 0.002, 0.004, 0.008, 1.0)]
    assert weights == sorted(weights)
    assert weights[0] == pytest.approx(0.0, abs=1e-3)
    assert weights[-1] == pytest.approx(1.0, abs=1e-2)
    assert layer_weight(0.003, 0.003, 0.5) == pytest.approx(0.5 - 0.5 / np.pi, rel=1e-12)


def test_wear_grows_with_the_path() -> None:
    worn = wear_part(LAB, [0.0, 100.0])
    assert not worn[0].any()
    assert worn[1, LATENTS.index("friction")] == pytest.approx(100 * LAB.friction_wear_per_m)


def test_a_texture_has_the_spread_and_length_that_were_asked_for() -> None:
    """Over mountings, between places as far apart as the length: exp(-1/2) of the variance."""
    luck = track(np.random.default_rng(6), 4000)
    at_m = np.array([0.0, LAB.texture_length_m, 3 * LAB.texture_length_m, 0.0205])
    made = texture(LAB, luck, texture_map(LAB, at_m), forward=True)
    np.testing.assert_allclose(made.std(axis=0), LAB.texture_sd_n_m, rtol=0.05)
    found = np.asarray(np.corrcoef(made.T))
    assert found[0, 1] == pytest.approx(np.exp(-0.5), abs=0.03)
    assert found[0, 2] == pytest.approx(np.exp(-4.5), abs=0.04)


@pytest.mark.parametrize(("share", "correlation"), [(0.0, 1.0), (1.0, -1.0), (0.5, 0.0)])
def test_a_share_of_the_texture_changes_sign_with_the_direction(share: float, correlation: float) -> None:
    world = replace(LAB, texture_reversing_share=share)
    luck, to_bins = track(np.random.default_rng(7), 3000), texture_map(world, np.array([0.0]))
    both = [texture(world, luck, to_bins, forward=forward)[:, 0] for forward in (True, False)]
    assert np.asarray(np.corrcoef(both))[0, 1] == pytest.approx(correlation, abs=0.05)


def test_the_zero_walks_and_a_bin_averages_the_noise() -> None:
    luck = np.random.default_rng(9).standard_normal((20_000, 42))
    made = bias(LAB, luck, 0.1, since_tare_s=16.0)
    walk = LAB.bias_walk_n_m_per_sqrt_s
    assert made[:, 0].std() == pytest.approx(np.sqrt(LAB.tare_sd_n_m**2 + walk**2 * 16.1), rel=0.03)
    assert made[:, -1].std() == pytest.approx(np.sqrt(LAB.tare_sd_n_m**2 + walk**2 * 20.0), rel=0.03)
    assert white_sd_n_m(15e-6, 15e-6, 100) == pytest.approx(15e-6 * np.sqrt(1 + 1 / 12) / 10)


def beaded(beside_m: float) -> Phantom:
    return Phantom(bead=Bead(depth_m=0.004, beside_m=beside_m))


def test_a_bead_beside_the_path_is_where_casting_and_mounting_put_it() -> None:
    """The nominal distance, which has a sign like theirs, and what both are off by; at its reach it ends."""
    probe, at = Probe(), LATENTS.index("beside_m2")
    under, aside = (
        np.array([
            SessionDraws(LAB, seed, probe, 0.004).row("A", beaded(beside_m), 1)
            for seed in range(1, 40)
        ])
        for beside_m in (0.0, 0.003)
    )  # fmt: skip
    np.testing.assert_array_equal(np.delete(under, at, axis=1), np.delete(aside, at, axis=1))
    off_m = np.sqrt(aside[:, at]) - 0.003
    np.testing.assert_allclose(np.abs(off_m), np.sqrt(under[:, at]), atol=1e-12)
    assert off_m.min() < 0.0 < off_m.max()
