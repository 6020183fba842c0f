"""L2's stated bounds at the corners of their boxes, where they are worst, against L4."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from palp_core.errors import MechanicsError, MethodError
from palp_core.methods import find
from palp_core.palpation.mechanics import (
    Bead,
    LayeredHertz,
    Phantom,
    Probe,
    Scene,
    StagePath,
    Tolerance,
    choose_rung,
    sweep,
)
from palp_core.palpation.mechanics.contact.l4 import HarmonicContact
from palp_core.palpation.mechanics.contact.model import BesideBead
from palp_core.palpation.mechanics.scene.choice import rung_model
from palp_core.palpation.mechanics.scene.output import contrast_n_m, peak_n_m
from palp_core.palpation.method_table.mechanics import _ABOUT, _NEAR, _PAPER, _PUBLISHED

STAGE_M = np.linspace(-0.03, 0.05, 81)
RINGS_M = (0.0, 0.016)
LOADS = [*itertools.product((3e3, 40e3), (0.2, 0.45), (0.0015, 0.003, 0.005), (0.002, 0.02))]
BOXES = {"published": _PUBLISHED, "paper": _PAPER, "near": _NEAR, "about": _ABOUT}
HALF = [c for c in itertools.product((0, 1), repeat=4) if sum(c) % 2 == 0]


def corner(
    box: Mapping[str, tuple[float, float]], at: tuple[int, ...], depth_m: float
) -> tuple[Phantom, float]:
    """Return phantom and ball at a corner of a box of geometry, of a soft gel."""
    names = ("bead_radius_m", "tip_radius_m", "height_m", "poisson")
    radius_m, tip_m, height_m, poisson = (box[name][end] for name, end in zip(names, at, strict=True))
    bead = Bead(depth_m=max(depth_m, 0.2501 * tip_m), radius_m=radius_m)
    return Phantom(bead=bead, height_m=height_m, poisson=poisson, modulus_pa=1.0), tip_m


@pytest.mark.slow
@pytest.mark.parametrize("beside_m", [0.0, 0.002])
@pytest.mark.parametrize("depth_m", [0.0015, 0.0019, 0.004, 0.0085])
@pytest.mark.parametrize("name", BOXES)
def test_stated_bounds_are_kept_at_the_corners_of_their_boxes(
    name: str, depth_m: float, beside_m: float
) -> None:
    l2, checked = find("contact", "l2"), 0
    for at in HALF:
        try:
            soft, tip_m = corner(BOXES[name], at, depth_m)
        except MechanicsError:  # the bead does not fit into the slab
            continue
        fine = HarmonicContact(soft, tip_m)
        for modulus_pa, friction, indentation_m, mass_kg in LOADS:
            assert soft.bead is not None
            bead = replace(soft.bead, beside_m=beside_m)
            phantom = replace(soft, bead=bead, modulus_pa=modulus_pa)
            probe = Probe(tip_radius_m=tip_m, friction=friction, tip_mass_kg=mass_kg)
            small_strain = HarmonicContact(phantom, tip_m)
            small_strain.__dict__["_table"] = fine._table
            models = [BesideBead(one, beside_m) for one in (small_strain, LayeredHertz(phantom, tip_m))]
            for ring_m in RINGS_M:
                scene = Scene(
                    phantom=phantom,
                    probe=probe,
                    path=StagePath(indentation_m=indentation_m),
                    ring_m=(ring_m,),
                    tolerance=Tolerance(output="peak", relative=1.0),
                )
                bounds = [l2.bound(output, scene.quantities()) for output in ("peak", "contrast", "trace")]
                if bounds == [None, None, None]:
                    continue
                try:
                    true, given = (sweep(m, probe, ring_m, indentation_m, STAGE_M) for m in models)
                except MechanicsError:  # the tip leads
                    continue
                errors = [of(given) / of(true) - 1.0 for of in (peak_n_m, contrast_n_m)]
                errors.append(float(np.abs(given.torque_n_m - true.torque_n_m).max() / peak_n_m(true)))
                for bound, error in zip(bounds, errors, strict=True):
                    assert bound is None or abs(error) <= bound, scene
                    checked += bound is not None
    assert checked > 100


def test_past_a_bead_2_mm_off_the_path_bounds_hold_and_at_5_mm_the_contrast_would_not() -> None:
    """Against L4, at the nominal load; from box to box the slow test above."""
    errors = {}
    for beside_m in (0.002, 0.005):
        phantom = Phantom(bead=Bead(depth_m=0.004, beside_m=beside_m))
        models = [rung_model(rung, phantom, 0.006) for rung in ("l2", "l4")]
        given, true = (sweep(one, Probe(), 0.016, 0.004, STAGE_M) for one in models)
        errors[beside_m] = [abs(of(given) / of(true) - 1.0) for of in (peak_n_m, contrast_n_m)]
    beside = Scene(phantom=Phantom(bead=Bead(depth_m=0.004, beside_m=0.002)), ring_m=(0.016,))
    bounds = [find("contact", "l2").bound(output, beside.quantities()) for output in ("peak", "contrast")]
    stated = [bound for bound in bounds if bound is not None]
    assert all(error <= bound for error, bound in zip(errors[0.002], stated, strict=True))
    assert errors[0.005][1] > stated[1]


@pytest.mark.parametrize(
    ("ring_m", "modulus_pa", "rung"), [(0.004, 20e3, "l2"), (0.016, 20e3, "l2"), (0.016, 15e3, "l4")]
)
def test_a_joint_that_hardly_gives_way_gets_the_finer_rung(
    ring_m: float, modulus_pa: float, rung: str
) -> None:
    """The joint's stiffness decides what an error of the force does to the peak."""
    scene = Scene(
        phantom=Phantom(bead=Bead(depth_m=0.002), modulus_pa=modulus_pa),
        ring_m=(ring_m,),
        tolerance=Tolerance(output="peak", relative=0.02),
    )
    assert choose_rung(scene).rung == rung


def test_yielding_is_the_moment_of_hertz_over_what_the_joint_holds() -> None:
    scene = Scene(ring_m=(0.004, 0.016))
    (small, large), probe = scene.quantities()["yielding"], scene.probe  # type: ignore[misc]
    hertz_n = 4.0 / 3.0 * 20e3 / (1.0 - 0.49**2) * math.sqrt(0.006) * 0.004**1.5
    assert large == pytest.approx(hertz_n * 0.064 / (2 * 0.016 * 0.0068 * 240 + probe.weight_n_m))
    assert small > 3.0 * large
    floating = Scene(probe=Probe(tip_mass_kg=0.0), ring_m=(0.0,)).quantities()["yielding"]
    assert floating == (math.inf,)


def test_no_contrast_is_bounded_on_a_path_that_ends_on_the_bead() -> None:
    near = Scene(
        path=StagePath(from_m=-0.01, to_m=0.05), tolerance=Tolerance(output="contrast", relative=0.3)
    )
    assert near.path.margin_m == 0.01
    with pytest.raises(MethodError, match="no error bound for 'contrast'"):
        choose_rung(near)
    assert StagePath(from_m=0.05, to_m=0.02).margin_m == -0.02
