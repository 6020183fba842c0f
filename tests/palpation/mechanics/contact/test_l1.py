"""Rung L1: columns of gel, against closed forms and brute-force integration."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import OutOfRange
from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom
from palp_core.palpation.mechanics.contact import ElasticFoundation

TIP_M = 0.006


def foundation(depth_m: float | None, poisson: float = 0.4, height_m: float = 0.030) -> ElasticFoundation:
    bead = None if depth_m is None else Bead(depth_m=depth_m)
    return ElasticFoundation(Phantom(bead=bead, poisson=poisson, height_m=height_m), TIP_M)


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45])
def test_a_thin_bonded_layer_has_its_closed_form(poisson: float) -> None:
    model, depth = foundation(None, poisson, 0.001), np.array([1e-5, 1e-4])
    modulus_pa = 20e3 * (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))
    expected_n = math.pi * modulus_pa * TIP_M * depth**2 / 0.001
    assert np.allclose(model.force(np.zeros(2), depth)[0], expected_n, rtol=1e-12)


@pytest.mark.parametrize(
    ("offset_m", "depth_m"), [(0.0, 0.002), (0.003, 0.002), (0.008, 0.004), (0.012, 0.002)]
)
def test_the_integral_over_rings_is_that_over_a_fine_grid(offset_m: float, depth_m: float) -> None:
    model, pressed_m = foundation(depth_m), 0.003
    x = (np.arange(2400) + 0.5) / 2400 * 0.013 - 0.0065
    across, beside = np.meshgrid(x + offset_m, x)
    squeeze = np.maximum(pressed_m - ((across - offset_m) ** 2 + beside**2) / (2 * TIP_M), 0.0)
    square = across**2 + beside**2
    thickness = np.where(
        square < 0.0075**2, depth_m + 0.0075 - np.sqrt(np.maximum(0.0075**2 - square, 0.0)), 0.030
    )
    area = (0.013 / 2400) ** 2
    normal = model.column_modulus_pa * area * float(np.sum(squeeze / thickness))
    lateral = (
        model.column_modulus_pa * area * float(np.sum(squeeze * (across - offset_m) / thickness)) / TIP_M
    )
    found = model.force(np.array(offset_m), np.array(pressed_m))
    assert float(found[0]) == pytest.approx(normal, rel=2e-4)
    assert float(found[1]) == pytest.approx(lateral, rel=1e-3, abs=1e-5 * normal)


@settings(deadline=None, max_examples=40)
@given(depth_m=st.floats(0.001, 0.014), offset_m=st.floats(-0.02, 0.02), pressed_m=st.floats(1e-4, 0.0055))
def test_both_forces_are_the_slopes_of_one_energy(depth_m: float, offset_m: float, pressed_m: float) -> None:
    model, step_m = foundation(depth_m), 1e-7
    normal_n, lateral_n = model.force(np.array(offset_m), np.array(pressed_m))
    ends = np.array([-step_m, step_m])
    by_depth = np.diff(model.energy(np.array(offset_m), pressed_m + ends))[0] / (2 * step_m)
    by_offset = np.diff(model.energy(offset_m + ends, np.array(pressed_m)))[0] / (2 * step_m)
    assert by_depth == pytest.approx(float(normal_n), rel=1e-5)
    assert by_offset == pytest.approx(float(lateral_n), rel=1e-3, abs=1e-5 * float(normal_n))
    mirrored = model.force(np.array(-offset_m), np.array(pressed_m))
    assert (float(mirrored[0]), float(mirrored[1])) == (float(normal_n), -float(lateral_n))


def test_its_forces_are_several_times_too_high_on_a_nearly_incompressible_gel() -> None:
    phantom = Phantom(poisson=0.49)
    ratio = [
        model.force(np.zeros(1), np.array([0.003]))[0][0]
        for model in (ElasticFoundation(phantom, TIP_M), LayeredHertz(phantom, TIP_M))
    ]
    assert 3.0 < ratio[0] / ratio[1] < 5.0


def test_the_modulus_diverges_towards_one_half_and_there_it_refuses() -> None:
    moduli = [foundation(None, nu).column_modulus_pa for nu in (0.45, 0.49, 0.499)]
    assert moduli[1] > 4 * moduli[0]
    assert moduli[2] > 9 * moduli[1]
    with pytest.raises(OutOfRange, match="poisson"):
        foundation(None, 0.4999)


def test_beyond_its_reach_the_bead_is_not_felt_and_beyond_the_ball_it_refuses() -> None:
    model = foundation(0.002)
    bare_n = foundation(None).force(np.zeros(1), np.array([0.006]))[0]
    assert model.force(np.array([model.reach_m]), np.array([0.006]))[0] == pytest.approx(bare_n, rel=1e-9)
    assert foundation(None).reach_m == 0.0
    assert np.all(model.force(np.zeros(2), np.array([-1.0, 0.0]))[0] == 0.0)
    with pytest.raises(OutOfRange, match="indentation_m"):
        model.force(np.zeros(1), np.array([0.0061]))
