"""Parameters are checked where they are made, and the joint obeys its closed form."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import OutOfRange
from palp_core.palpation.mechanics import Bead, Phantom, Probe, StagePath


@pytest.mark.parametrize("depth_m", [-0.001, 0.0, math.nan, math.inf])
def test_a_bead_refuses_a_depth_that_is_no_depth(depth_m: float) -> None:
    with pytest.raises(OutOfRange, match="depth_m") as caught:
        Bead(depth_m=depth_m)
    assert caught.value.quantity == "depth_m"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("modulus_pa", 0.0),
        ("modulus_pa", math.nan),
        ("poisson", 0.51),
        ("poisson", -0.1),
        ("height_m", -0.03),
    ],
)
def test_a_phantom_names_the_quantity_it_refuses(name: str, value: float) -> None:
    given_: dict[str, Any] = {name: value}
    with pytest.raises(OutOfRange) as caught:
        Phantom(**given_)
    assert caught.value.quantity == name


def test_a_bead_may_rest_on_the_floor_but_not_reach_below_it() -> None:
    assert Phantom(bead=Bead(depth_m=0.015)).scene()["depth_m"] == 0.015
    with pytest.raises(OutOfRange, match="below the floor"):
        Phantom(bead=Bead(depth_m=0.0151))


@pytest.mark.parametrize(
    ("name", "value"),
    [("friction", -0.1), ("tip_radius_m", 0.0), ("tip_radius_m", 0.08), ("tip_mass_kg", math.nan)],
)
def test_a_probe_names_the_dimension_it_refuses(name: str, value: float) -> None:
    given_: dict[str, Any] = {name: value}
    with pytest.raises(OutOfRange) as caught:
        Probe(**given_)
    assert caught.value.quantity == name


def test_the_joint_torque_is_that_of_two_springs_of_zero_free_length() -> None:
    probe, ring_m = Probe(), 0.008
    for angle_rad in np.radians([-80.0, -15.0, 0.0, 20.0, 80.0]):
        energy_j = [
            sum(
                0.5 * probe.spring_n_per_m * ((ring_m - x * math.sin(q)) ** 2 + (x * math.cos(q)) ** 2)
                for x in (probe.pivot_radius_m, -probe.pivot_radius_m)
            )
            for q in (angle_rad - 1e-6, angle_rad + 1e-6)
        ]
        assert energy_j[0] == pytest.approx(energy_j[1])  # a pivot across the ring's axis would feel nothing
        anchored_j = [
            0.5 * probe.spring_n_per_m * 2.0 * (ring_m**2 + probe.pivot_radius_m**2)
            - 2.0 * probe.spring_n_per_m * ring_m * probe.pivot_radius_m * math.cos(q)
            for q in (angle_rad - 1e-6, angle_rad + 1e-6)
        ]
        assert (anchored_j[1] - anchored_j[0]) / 2e-6 == pytest.approx(
            probe.joint_torque(ring_m, angle_rad), abs=1e-9
        )


@settings(deadline=None, max_examples=30)
@given(ring_m=st.floats(0.0, 0.02), angle_rad=st.floats(-1.5, 1.5))
def test_the_joint_stiffness_is_the_slope_of_the_joint_torque(ring_m: float, angle_rad: float) -> None:
    probe = Probe()
    slope = (
        probe.joint_torque(ring_m, angle_rad + 1e-5) - probe.joint_torque(ring_m, angle_rad - 1e-5)
    ) / 2e-5
    assert probe.joint_stiffness(ring_m, angle_rad) == pytest.approx(slope, abs=1e-9)


def test_a_path_samples_from_its_start_to_its_end() -> None:
    stage_m = StagePath().stage_m()
    assert len(stage_m) == 4001
    assert stage_m[0] == -0.03
    assert stage_m[-1] == pytest.approx(0.05)
    backwards = StagePath(from_m=0.03, to_m=-0.05).stage_m()
    assert np.allclose(backwards, -stage_m)


@pytest.mark.parametrize(("name", "value"), [("speed_m_s", 0.0), ("speed_m_s", math.nan), ("to_m", -0.03)])
def test_a_path_refuses_what_is_no_path(name: str, value: float) -> None:
    given_: dict[str, Any] = {name: value}
    with pytest.raises(OutOfRange) as caught:
        StagePath(**given_)
    assert caught.value.quantity == name
