"""One sweep of a world at any position is the sweep that the parts of the world make."""

from dataclasses import replace

import numpy as np
import pytest

from palp_core.errors import OutOfRange
from palp_core.palpation.mechanics import Bead, Phantom, Probe, solve
from palp_core.palpation.world.drag import drag
from palp_core.palpation.world.latents import latents
from palp_core.palpation.world.model import LAB, PAPER
from palp_core.palpation.world.texture import texture, texture_map, track
from palp_core.palpation.world.touch import Touch, touch
from palp_core.palpation.world.trace import trace

PROBE, STAGE_M = Probe(), np.arange(-0.03, 0.05, 2e-5)
LUCK = track(np.random.default_rng(2), 1)[0]
ROW = latents(height_m=0.1e-3, modulus=0.1, along_m=1e-3, beside_m2=1e-6)[0]


@pytest.fixture(scope="module")
def felt() -> Touch:
    return touch(Phantom(bead=Bead(depth_m=0.002)), PROBE, "l2")


def test_in_the_papers_world_it_is_the_sweep_that_was_always_solved(felt: Touch) -> None:
    made = trace(felt, PAPER, latents()[0], LUCK, 0.016, 0.004, -0.032, 0.052)
    known = solve(felt.models[1], PROBE, 0.016, 0.004, -0.032, 0.052)
    np.testing.assert_allclose(made.torque_n_m(STAGE_M), known.torque_n_m(STAGE_M), atol=1.3e-5)
    np.testing.assert_allclose(made.normal_n(STAGE_M), known.normal_n(STAGE_M), atol=5.5e-4)
    assert made.run_in_m == made.hertz == 0.0


@pytest.mark.parametrize(("from_m", "to_m"), [(-0.03, 0.05), (0.05, -0.03)], ids=["forward", "back"])
def test_it_is_drag_and_texture_at_every_position(felt: Touch, from_m: float, to_m: float) -> None:
    world = replace(LAB, static_friction_excess=0.0)
    made = trace(felt, world, ROW, LUCK, 0.012, 0.004, from_m, to_m)
    at_m = np.linspace(from_m, to_m, 1601)
    whole = drag(felt, ROW[None], np.array([0.012]), 0.004, at_m)
    rough = texture(world, LUCK[None], texture_map(world, whole.tip_m[0]), forward=to_m > from_m)[0]
    error = made.torque_n_m(at_m) - whole.torque_n_m[0] - rough
    assert np.sqrt(np.square(error).mean()) < 0.01e-3
    assert np.abs(error).max() < 0.05e-3
    assert made.run_in_m == pytest.approx(whole.loose_m[0], abs=1e-8)


def test_beyond_its_ends_it_stays_as_it_is(felt: Touch) -> None:
    made = trace(felt, PAPER, ROW, LUCK, 0.008, 0.004, -0.03, 0.05)
    ends = made.torque_n_m(np.array([-0.03, 0.05]))
    np.testing.assert_array_equal(made.torque_n_m(np.array([-0.04, 0.06])), ends)


def test_stick_slip_that_swamps_the_nodule_is_a_guard(felt: Touch) -> None:
    loud = trace(felt, replace(LAB, static_friction_excess=0.3), ROW, LUCK, 0.016, 0.004, -0.03, 0.05)
    assert loud.hertz > 5.0
    assert any(words.startswith("stick-slip: ") for words in loud.solved.guards)
    still = trace(felt, replace(LAB, static_friction_excess=0.0), ROW, LUCK, 0.016, 0.004, -0.03, 0.05)
    assert not still.solved.guards
    added = loud.torque_n_m(STAGE_M) - still.torque_n_m(STAGE_M)
    assert np.abs(added[:600]).max() == 0.0  # it has not broken loose
    assert np.ptp(added[2000:]) > 2e-3


def test_a_sweep_of_no_length_is_refused(felt: Touch) -> None:
    with pytest.raises(OutOfRange, match="too short"):
        trace(felt, LAB, ROW, LUCK, 0.008, 0.004, 0.0, 0.001)
