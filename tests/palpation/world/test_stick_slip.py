"""Stick-slip is predicted where the joint in motion sticks and slips, as often and as far."""

import numpy as np
import pytest

from palp_core.palpation.mechanics import Bead, Phantom, Probe
from palp_core.palpation.mechanics.equilibrium.dynamics import Dynamics, simulate
from palp_core.palpation.world.drag import Dragged, Joints, drag, joints_of
from palp_core.palpation.world.latents import latents
from palp_core.palpation.world.stick_slip import stick_slip, swamped
from palp_core.palpation.world.touch import Touch, touch

PROBE, RINGS_M = Probe(), np.array([0.004, 0.016])
STAGE_M = np.linspace(-0.03, 0.05, 81)
SPEED_M_S = 0.02


@pytest.fixture(scope="module")
def felt() -> Touch:
    return touch(Phantom(bead=Bead(depth_m=0.008)), PROBE, "l2", tips=False)


@pytest.fixture(scope="module")
def swept(felt: Touch) -> tuple[Joints, Dragged]:
    return joints_of(felt, latents(2), RINGS_M, 0.004, 1.0), drag(felt, latents(2), RINGS_M, 0.004, STAGE_M)


@pytest.mark.parametrize(
    ("excess", "hums"),
    [
        (0.1, (False, True)),
        pytest.param(0.02, (False, False), marks=pytest.mark.nightly),
        pytest.param(0.3, (True, True), marks=pytest.mark.nightly),
    ],
)
def test_a_joint_in_motion_sticks_and_slips_where_that_is_predicted(
    felt: Touch, swept: tuple[Joints, Dragged], excess: float, hums: tuple[bool, bool]
) -> None:
    """Time-stepped with static friction, from rest, long after it broke loose."""
    dynamics = Dynamics(step_s=4e-4, static_friction=PROBE.friction * (1.0 + excess))
    moved = simulate(felt.models[0], PROBE, RINGS_M, 0.004, -0.03, -0.0005, SPEED_M_S, dynamics, at_rest=True)
    known = stick_slip(*swept, excess, SPEED_M_S)
    late = moved.stage_m > -0.0045
    for ring in (0, 1):
        stuck = np.abs(moved.slip_m_s[ring, late]) < 1e-9
        assert stuck.any() == hums[ring]
        assert (known.hertz[ring, 27] > 0.0) == hums[ring]
        if hums[ring]:
            caught = np.flatnonzero(np.diff(stuck.astype(int)) == 1)
            hertz = SPEED_M_S / np.diff(moved.stage_m[late][caught]).mean()
            assert known.hertz[ring, 27] == pytest.approx(hertz, rel=0.04)
            swing = np.ptp(moved.torque_n_m[ring, late])
            assert known.swing_n_m[ring, 27] == pytest.approx(swing, rel=0.06)


def test_its_torque_turns_as_often_as_it_says(swept: tuple[Joints, Dragged]) -> None:
    known = stick_slip(*swept, 0.1, SPEED_M_S)
    fine_m = np.arange(-0.01, 0.0, 2e-5)
    made = known.added(STAGE_M, fine_m, SPEED_M_S, np.zeros(2))
    assert not made[0].any()
    falls = np.count_nonzero((made[1, 1:] < 0.0) & (made[1, :-1] >= 0.0))
    assert falls == pytest.approx(known.hertz[1, 25] * 0.01 / SPEED_M_S, abs=1.0)
    assert np.ptp(made[1]) == pytest.approx(known.swing_n_m[1, 25], rel=0.05)
    shifted = known.added(STAGE_M, fine_m, SPEED_M_S, np.full(2, 0.5))
    assert np.asarray(np.corrcoef(made[1], shifted[1]))[0, 1] < 0.0


def test_faster_it_slides_smoothly(swept: tuple[Joints, Dragged]) -> None:
    assert not stick_slip(*swept, 0.05, 0.1).hertz.any()


def test_a_swing_that_swamps_the_nodule_is_noted(swept: tuple[Joints, Dragged]) -> None:
    _, found = swept
    assert swamped(found, stick_slip(*swept, 0.02, SPEED_M_S), 1) == ""
    words = swamped(found, stick_slip(*swept, 0.1, SPEED_M_S), 1)
    assert words.startswith("stick-slip: a swing of 2.4 N mm at 14 Hz")
    assert "sweep faster" in words
