"""Rung L2 against closed forms, the exact bonded layer, finite elements over a bead, and its own laws."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from palp_core.errors import OutOfRange
from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom
from palp_core.palpation.mechanics.contact.l2 import layer_series
from palp_core.palpation.mechanics.tip import over_paraboloid

TIP_M = 0.006
DEPTHS_M = st.floats(0.0015, 0.014)
OFFSETS_M = st.floats(-0.025, 0.025)
INDENTATIONS_M = st.floats(1e-4, 0.005)
law = settings(deadline=None, max_examples=40)


def over_bead(depth_m: float, modulus_pa: float = 20e3, height_m: float = 0.030) -> LayeredHertz:
    phantom = Phantom(bead=Bead(depth_m=depth_m), modulus_pa=modulus_pa, height_m=height_m)
    return LayeredHertz(phantom, TIP_M)


def at(model: LayeredHertz, offset_m: float, indentation_m: float) -> tuple[float, float]:
    normal_n, lateral_n = model.force(np.array(offset_m), np.array(indentation_m))
    return float(normal_n), float(lateral_n)


def sneddon(share: float) -> tuple[float, float]:
    """Return radius and force of a rigid sphere's contact with a half-space, for R = 1 and E' = 1.

    Sneddon 1965, his equations solved: delta = a artanh a, N = (1 + a^2) artanh a - a.
    """
    a = brentq(lambda a: a * math.atanh(a) - share, 0.0, 1.0 - 1e-12, xtol=1e-15)
    return a, (1.0 + a * a) * math.atanh(a) - a


@pytest.mark.parametrize(("share", "within"), [(0.1, 2e-5), (0.5, 2e-4), (1.0, 1.2e-3)])
def test_a_very_high_slab_is_sneddons_half_space(share: float, within: float) -> None:
    normal_n = at(LayeredHertz(Phantom(height_m=10.0), TIP_M), 0.0, share * TIP_M)[0]
    expected_n = 20e3 / (1.0 - 0.49**2) * TIP_M**2 * sneddon(share)[1]
    assert normal_n == pytest.approx(expected_n, rel=within + 1e-3)


@pytest.mark.parametrize("power", range(5))
def test_the_series_in_the_indentation_are_those_of_sneddons_force_and_radius(power: int) -> None:
    for share in (0.01, 0.02):  # what is left out is of the third order, with coefficients below 0.2
        radius, force = sneddon(share)
        expected = force / (4.0 / 3.0 * share**1.5) * (radius / math.sqrt(share)) ** power
        series = np.polynomial.Polynomial(over_paraboloid(power))(share)
        assert series == pytest.approx(expected, abs=0.2 * share**3)


def test_the_layers_coefficients_are_the_published_ones_at_nu_one_half() -> None:
    series = layer_series(0.5)
    assert series[:4] == pytest.approx((1.0, 1.133, 1.283, 0.769), abs=1e-3)
    assert abs(series[4]) == pytest.approx(0.0975, abs=1e-4)


def exact_layer(radius_of_contact: float, poisson: float, tip_radius: float) -> tuple[float, float]:
    """Return (delta, N over Hertz) of a ball on a bonded layer of height 1.

    With p-hat(k) = int_0^a g(t) cos(kt) dt the contact is the Fredholm equation
    g(t) = (E'/pi)(delta - f(t)) + (2/pi) int_0^a g(x) int_0^inf (1 - L(k)) cos(kt) cos(kx) dk dx, g(a) = 0,
    with L the bonded layer's transform (Lebedev and Ufliand 1958); E' = 1. f(t), t times the
    integral of w'(r) / sqrt(t^2 - r^2) to t, is t artanh(t / R).
    """
    nodes, weights = np.polynomial.legendre.leggauss(40)
    t, wt = (nodes + 1.0) / 2.0 * radius_of_contact, weights * radius_of_contact / 2.0
    nodes, weights = np.polynomial.legendre.leggauss(300)
    k, wk = (nodes + 1.0) * 15.0, weights * 15.0
    ka = 3.0 - 4.0 * poisson
    layer = (2 * ka * np.sinh(2 * k) - 4 * k) / (2 * ka * np.cosh(2 * k) + 4 * k**2 + 1 + ka**2)
    cosines = np.cos(np.outer(np.append(t, radius_of_contact), k))
    kernel = 2.0 / np.pi * (cosines * ((1.0 - layer) * wk)) @ cosines[:-1].T * wt
    system = np.eye(len(t)) - kernel[:-1]
    by_depth = np.linalg.solve(system, np.full(len(t), 1.0 / np.pi))
    x = np.append(t, radius_of_contact)
    shape = x * np.arctanh(x / tip_radius)
    by_shape = np.linalg.solve(system, shape[:-1] / np.pi)
    indentation = (shape[-1] / np.pi + kernel[-1] @ by_shape) / (1.0 / np.pi + kernel[-1] @ by_depth)
    force = 2.0 * np.pi * wt @ (indentation * by_depth - by_shape)
    return float(indentation), float(force / (4.0 / 3.0 * math.sqrt(tip_radius) * indentation**1.5))


@pytest.mark.parametrize("poisson", [0.45, 0.49, 0.5])
@pytest.mark.parametrize(
    ("share", "within"), [(0.1, 2e-3), (0.3, 4e-3), (0.5, 6e-3), (0.7, 6e-3), (0.83, 6e-3)]
)
def test_bare_gel_under_a_sphere_is_the_exact_bonded_layer(
    poisson: float, share: float, within: float
) -> None:
    """The published ball and slab; ``share`` is the contact's radius over the ball's."""
    tip_radius = TIP_M / 0.030
    indentation, ratio = exact_layer(share * tip_radius, poisson, tip_radius)
    indentation_m = indentation * 0.030
    hertz_n = 4.0 / 3.0 * 20e3 / (1.0 - poisson**2) * math.sqrt(TIP_M) * indentation_m**1.5
    model = LayeredHertz(Phantom(poisson=poisson), TIP_M)
    assert at(model, 0.0, indentation_m)[0] / hertz_n == pytest.approx(ratio, rel=within)


@law
@given(indentation_m=INDENTATIONS_M, shallow_m=st.floats(0.0015, 0.014), more_m=st.floats(1e-4, 1e-3))
def test_a_deeper_bead_gives_a_smaller_force(indentation_m: float, shallow_m: float, more_m: float) -> None:
    shallow_n, deep_n = (at(over_bead(d), 0.0, indentation_m)[0] for d in (shallow_m, shallow_m + more_m))
    assert deep_n < shallow_n


def test_a_film_of_gel_over_the_bead_is_refused() -> None:
    with pytest.raises(OutOfRange, match="too thin"):
        over_bead(0.0009)
