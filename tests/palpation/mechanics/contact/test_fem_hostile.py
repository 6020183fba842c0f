"""Finite-element rungs under a thousand hostile inputs: a valid answer or an error by name, no warning."""

from __future__ import annotations

import math

import numpy as np
import pytest

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics import Bead, Phantom
from palp_core.palpation.mechanics.contact.l4 import HarmonicContact
from palp_core.palpation.mechanics.contact.l5 import FiniteStrainContact

NASTY = [math.nan, math.inf, -math.inf, 0.0, -1e-3, 1e-300, 1e300, 5e-324]


def drawn(rng: np.random.Generator, usual: list[float]) -> float:
    pool = NASTY if rng.random() < 0.12 else usual
    return float(pool[rng.integers(len(pool))])


@pytest.mark.slow
def test_a_thousand_hostile_scenes_end_in_an_answer_or_a_named_error() -> None:
    rng, answered, refused = np.random.default_rng(20), 0, 0
    rungs: list[type[HarmonicContact | FiniteStrainContact]] = [HarmonicContact, FiniteStrainContact]
    for _ in range(1000):
        try:
            # One geometry may be set up, in two moduli; the rest must be refused before any elements.
            depth_m, height_m = drawn(rng, [0.004, 0.004, 1e-7, 0.5]), drawn(rng, [0.030, 0.030, 0.011])
            poisson, tip_m = drawn(rng, [0.49, 0.49, 0.4999999, 0.5]), drawn(rng, [0.006])
            bead = None if rng.random() < 0.5 else Bead(depth_m=depth_m)
            phantom = Phantom(
                bead=bead, modulus_pa=drawn(rng, [1.0, 20e3, 1e9]), poisson=poisson, height_m=height_m
            )
            model = rungs[rng.integers(2)](phantom, tip_m)
            offset_m = np.array([drawn(rng, [0.0, 0.0, 0.005]) for _ in range(2)])
            indentation_m = np.array([drawn(rng, [1e-9, 0.001, 0.003, -0.1, 10.0]) for _ in range(2)])
            normal_n, lateral_n = model.force(offset_m, indentation_m)
            energy_j = model.energy(offset_m, indentation_m)
        except MechanicsError:
            refused += 1
            continue
        answered += 1
        assert np.all(np.isfinite(normal_n) & np.isfinite(lateral_n) & np.isfinite(energy_j))
        assert np.all(normal_n >= 0.0)
        assert np.all(energy_j >= 0.0)
        assert np.all(normal_n[indentation_m <= 0.0] == 0.0)
    assert answered > 50
    assert refused > 400


@pytest.mark.slow
@pytest.mark.parametrize("poisson", [0.3, 0.4999])
@pytest.mark.parametrize(
    ("depth_m", "radius_m", "height_m", "tip_m"),
    [
        (0.0005, 0.012, 0.060, 0.012),
        (0.0005, 0.002, 0.015, 0.012),
        (0.0005, 0.012, 0.0245, 0.002),  # the bead stands on the floor
        (0.015, 0.012, 0.039, 0.012),  # so does this one
        (0.015, 0.002, 0.060, 0.002),
    ],
)
def test_every_corner_of_the_range_is_answered(
    depth_m: float, radius_m: float, height_m: float, tip_m: float, poisson: float
) -> None:
    phantom = Phantom(bead=Bead(depth_m=depth_m, radius_m=radius_m), height_m=height_m, poisson=poisson)
    model = HarmonicContact(phantom, tip_m)
    offset_m = np.linspace(0.0, 1.5 * model.reach_m, 30)[:, None]
    normal_n, lateral_n = model.force(offset_m, np.linspace(0.0, tip_m, 20))
    assert np.all(np.isfinite(normal_n) & np.isfinite(lateral_n))
    assert np.all(np.diff(normal_n, axis=1) > 0.0)
    bare_n = HarmonicContact(Phantom(height_m=height_m, poisson=poisson), tip_m).force(
        np.zeros(()), np.linspace(0.0, tip_m, 20)
    )[0]
    assert np.all(normal_n >= bare_n * (1 - 1e-3))
