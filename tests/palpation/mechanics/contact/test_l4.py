"""Rung L4: its laws, its limits, and its cells against finer ones."""

from __future__ import annotations

import math

import numpy as np
import pytest

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.methods import find
from palp_core.palpation.mechanics import Bead, Phantom, Probe, sweep
from palp_core.palpation.mechanics.contact.l4 import HarmonicContact

TIP_M = 0.006
ORIGIN = np.zeros(())


def over(depth_m: float | None, cell_m: float = 0.001, modulus_pa: float = 20e3) -> HarmonicContact:
    bead = None if depth_m is None else Bead(depth_m=depth_m)
    return HarmonicContact(Phantom(bead=bead, modulus_pa=modulus_pa), TIP_M, cell_m)


@pytest.fixture(scope="module")
def model() -> HarmonicContact:
    return over(0.004)


@pytest.fixture(scope="module")
def bare() -> HarmonicContact:
    return over(None)


def at(model: HarmonicContact, offset_m: float, indentation_m: float) -> tuple[float, float]:
    normal_n, lateral_n = model.force(np.array(offset_m), np.array(indentation_m))
    return float(normal_n), float(lateral_n)


@pytest.mark.parametrize("offset_m", [0.0, 0.003, 0.02])
@pytest.mark.parametrize("indentation_m", [0.0011, 0.0041])
def test_between_its_nodes_the_table_is_the_contact_solved_there(
    model: HarmonicContact, offset_m: float, indentation_m: float
) -> None:
    patch, step_m, modulus_pa = model.patch(indentation_m), 1e-5, model.phantom.modulus_pa
    normal_n, lateral_n = at(model, offset_m, indentation_m)
    assert normal_n == pytest.approx(modulus_pa * patch.press(offset_m).normal_n, rel=1e-3)
    energies = [float(patch.press(offset_m + end).force_n @ patch._overlap) for end in (-step_m, step_m)]
    slope = modulus_pa * (energies[1] - energies[0]) / (2 * step_m)
    assert lateral_n == pytest.approx(slope, rel=0.02, abs=2e-4)


def test_the_force_falls_with_offset_to_that_of_bare_gel(
    model: HarmonicContact, bare: HarmonicContact
) -> None:
    indentation_m = np.array([0.001, 0.003, 0.006])
    normal_n = model.force(np.linspace(0.0, 0.05, 60)[:, None], indentation_m)[0]
    alone_n = bare.force(ORIGIN, indentation_m)[0]
    assert np.all(np.diff(normal_n, axis=0) <= 1e-12)
    assert np.all(normal_n >= alone_n)
    assert np.allclose(normal_n[-1], alone_n, rtol=2e-3)
    assert at(model, model.reach_m, 0.003)[0] == pytest.approx(at(bare, 0.0, 0.003)[0], rel=0.01)


@pytest.mark.parametrize(
    ("quantity", "make"),
    [
        ("depth_m", lambda: HarmonicContact(Phantom(bead=Bead(depth_m=0.0004)), TIP_M)),
        ("depth_m", lambda: HarmonicContact(Phantom(bead=Bead(depth_m=0.016), height_m=0.06), TIP_M)),
        ("bead_radius_m", lambda: HarmonicContact(Phantom(bead=Bead(depth_m=0.004, radius_m=0.0019)), TIP_M)),
        ("poisson", lambda: HarmonicContact(Phantom(poisson=0.5), TIP_M)),
        ("height_m", lambda: HarmonicContact(Phantom(height_m=0.1), TIP_M)),
        ("tip_radius_m", lambda: HarmonicContact(Phantom(), math.nan)),
        ("cell_m", lambda: HarmonicContact(Phantom(), TIP_M, 0.0)),
    ],
)
def test_what_is_out_of_range_is_refused_by_name(quantity: str, make: object) -> None:
    assert callable(make)
    with pytest.raises(OutOfRange) as caught:
        make()
    assert caught.value.quantity == quantity


def scene_drawn(rng: np.random.Generator) -> tuple[Phantom, float]:
    """Draw a phantom and a ball from the whole range; half of the beads do not fit and raise."""
    depth_m = math.exp(rng.uniform(math.log(0.0005), math.log(0.015)))
    bead = Bead(depth_m=depth_m, radius_m=rng.uniform(0.002, 0.012))
    height_m, poisson = rng.uniform(0.015, 0.060), 0.5 - 10 ** rng.uniform(-4.0, math.log10(0.2))
    tip_m, modulus_pa = rng.uniform(0.0021, 0.012), math.exp(rng.uniform(math.log(5e3), math.log(30e3)))
    return Phantom(bead=bead, height_m=height_m, poisson=poisson, modulus_pa=modulus_pa), tip_m


@pytest.mark.slow
def test_the_stated_bounds_hold_in_random_scenes() -> None:
    rng, compared = np.random.default_rng(4), 0
    while compared < 20:
        try:
            phantom, tip_m = scene_drawn(rng)
        except MechanicsError:
            continue
        coarse, fine = (HarmonicContact(phantom, tip_m, cell_m) for cell_m in (0.001, 0.0005))
        bounds = {
            name: find("contact", "l4").bound(name, phantom.scene())
            for name in ("normal", "peak", "contrast")
        }
        offset_m = rng.uniform(0.0, coarse.reach_m, 20)
        indentation_m = rng.uniform(0.001, min(tip_m, 0.006), 20)
        error = coarse.force(offset_m, indentation_m)[0] / fine.force(offset_m, indentation_m)[0] - 1.0
        assert np.abs(error).max() <= (bounds["normal"] or 0.0), (phantom, tip_m)
        compared += 1
        ring_m, nominal_m = rng.uniform(0.004, 0.016), rng.uniform(0.002, min(tip_m, 0.005))
        probe, stage_m = Probe(tip_radius_m=tip_m), np.linspace(-0.06, 0.1, 161)
        try:
            torques = [sweep(each, probe, ring_m, nominal_m, stage_m).torque_n_m for each in (coarse, fine)]
        except MechanicsError:
            continue  # the tip leads
        peaks = [float(torque.max()) for torque in torques]
        contrasts = [float(torque.max() - torque[0]) for torque in torques]
        assert peaks[0] == pytest.approx(peaks[1], rel=bounds["peak"]), (phantom, tip_m)
        assert contrasts[0] == pytest.approx(contrasts[1], rel=bounds["contrast"]), (phantom, tip_m)


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
    model, at_m = HarmonicContact(phantom, tip_m), np.linspace(0.0, tip_m, 20)
    normal_n, lateral_n = model.force(np.linspace(0.0, 1.5 * model.reach_m, 30)[:, None], at_m)
    assert np.isfinite(lateral_n).all()
    assert np.all(np.diff(normal_n, axis=1) > 0.0)
    bare = HarmonicContact(Phantom(height_m=height_m, poisson=poisson), tip_m)
    assert np.all(normal_n >= bare.force(ORIGIN, at_m)[0] * (1 - 1e-3))
