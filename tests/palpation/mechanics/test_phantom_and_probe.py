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
from palp_core.palpation.mechanics.equilibrium.dynamics import Dynamics


def test_a_bead_may_rest_on_the_floor_but_not_reach_below_it() -> None:
    assert Phantom(bead=Bead(depth_m=0.015)).scene()["depth_m"] == 0.015
    with pytest.raises(OutOfRange, match="below the floor"):
        Phantom(bead=Bead(depth_m=0.0151))


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


@settings(deadline=None, max_examples=15)
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


@pytest.mark.parametrize(
    ("kind", "name", "values"),
    [
        (Bead, "depth_m", [-0.001, 0.0, math.nan, math.inf]),
        (Phantom, "modulus_pa", [0.0, math.nan]),
        (Phantom, "poisson", [0.51, -0.1]),
        (Phantom, "height_m", [-0.03]),
        (Probe, "friction", [-0.1]),
        (Probe, "tip_radius_m", [0.0, 0.08]),
        (Probe, "tip_mass_kg", [math.nan]),
        (StagePath, "speed_m_s", [0.0, math.nan]),
        (StagePath, "to_m", [-0.03]),
        *((Dynamics, name, [math.nan]) for name in ("inertia_kg_m2", "damping_n_m_s", "regular_m_s")),
        *((Dynamics, name, [math.nan]) for name in ("step_s", "static_friction")),
    ],
)
def test_what_is_no_such_quantity_is_refused_by_its_name(
    kind: type[Any], name: str, values: list[float]
) -> None:
    for value in values:
        with pytest.raises(OutOfRange) as caught:
            kind(**{name: value})
        assert caught.value.quantity == name
