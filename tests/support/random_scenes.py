"""Random scenes within the allowed ranges."""

import math
from dataclasses import replace

import numpy as np

from palp_core.errors import OutOfRange
from palp_core.palpation.mechanics import Bead, Phantom, Probe, Scene, StagePath, Tolerance

_OUTPUTS = ("peak", "contrast", "separation", "decision")  # the trace is judged in every scene


def random_scene(rng: np.random.Generator) -> Scene:
    """Return a scene that a user might ask for: half about the published rig, half anywhere in the ranges."""
    while True:
        try:
            return _draw(rng)
        except OutOfRange:  # the bead does not fit into the slab
            continue


def _draw(rng: np.random.Generator) -> Scene:
    usual = bool(rng.random() < 0.5)

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    def log_between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    tip_m = between(0.005, 0.007) if usual else between(0.002, 0.012)
    bead = Bead(
        depth_m=between(0.0015, 0.010) if usual else log_between(0.0005, 0.015),
        radius_m=between(0.0065, 0.0085) if usual else between(0.002, 0.012),
    )
    anything = (1.0, 1e9) if rng.random() < 0.2 else (2e3, 200e3)
    phantom = Phantom(
        bead=bead,
        modulus_pa=between(5e3, 30e3) if usual else log_between(*anything),
        poisson=between(0.47, 0.495) if usual else between(0.3, 0.4999),
        height_m=between(0.028, 0.035) if usual else between(0.015, 0.060),
    )
    probe = Probe(
        tip_radius_m=tip_m,
        friction=between(0.2, 0.4) if usual else between(0.1, 0.6),
        tip_mass_kg=0.008 if usual else between(0.002, 0.02),
    )
    output = str(rng.choice(_OUTPUTS))
    depths: tuple[float, ...] = ()
    if output in ("separation", "decision"):
        second = bead.depth_m * between(1.3, 3.0)
        depths = (bead.depth_m, second)
        Phantom(bead=Bead(depth_m=second, radius_m=bead.radius_m), height_m=phantom.height_m)  # does it fit?
        if second > 0.015:
            raise OutOfRange("depths_m", "too deep")
    elif output == "peak" and rng.random() < 0.1:
        phantom = replace(phantom, bead=None)
    tolerance = Tolerance(output=output, relative=log_between(0.01, 0.3), depths_m=depths)
    rings = rng.choice([0.0, 0.004, 0.008, 0.012, 0.016], size=2, replace=False)
    if not usual and rng.random() < 0.5:
        rings = rng.uniform(0.0, 0.02, 2)
    deepest_m = min(0.005, 0.8 * tip_m) if usual else min(0.006, 0.95 * tip_m)
    indentation_m = between(min(0.001, 0.5 * deepest_m), deepest_m)
    ends = (-0.03, 0.05) if usual else (-between(0.025, 0.05), between(0.025, 0.05))
    if not usual and rng.random() < 0.5:
        ends = ends[::-1]
    path = StagePath(indentation_m=indentation_m, from_m=ends[0], to_m=ends[1])
    ring_m = tuple(sorted(float(r) for r in rings))
    return Scene(phantom=phantom, probe=probe, path=path, ring_m=ring_m, tolerance=tolerance)


def near_scene(rng: np.random.Generator) -> Scene:
    """Return a scene within 7 % of the published rig's lengths, or 2 %, under a load like its own."""
    while True:
        try:
            return _draw_near(rng)
        except OutOfRange:  # the bead does not fit into the slab
            continue


def _draw_near(rng: np.random.Generator) -> Scene:
    wide = 1.0 if rng.random() < 0.5 else 0.2

    def about(middle: float, half: float) -> float:
        return float(middle + wide * half * rng.uniform(-1.0, 1.0))

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    bead = Bead(depth_m=between(0.0015, 0.010), radius_m=about(0.0075, 0.0005))
    phantom = Phantom(
        bead=bead,
        modulus_pa=between(8e3, 40e3),
        poisson=about(0.49, 0.005),
        height_m=about(0.030, 0.002),
    )
    probe = Probe(
        tip_radius_m=about(0.006, 0.0005), friction=between(0.2, 0.45), tip_mass_kg=between(0.002, 0.02)
    )
    output = str(rng.choice(_OUTPUTS))
    depths: tuple[float, ...] = ()
    if output in ("separation", "decision"):
        depths = (bead.depth_m, min(bead.depth_m * between(1.3, 3.0), 0.012))
        replace(phantom, bead=replace(bead, depth_m=depths[1]))  # does it fit?
    tolerance = Tolerance(output=output, relative=float(np.exp(between(-4.6, -1.2))), depths_m=depths)
    rings = sorted(float(r) for r in rng.choice([0.0, 0.004, 0.008, 0.012, 0.016], size=2, replace=False))
    path = StagePath(indentation_m=between(0.0025, 0.005))
    return Scene(phantom=phantom, probe=probe, path=path, ring_m=tuple(rings), tolerance=tolerance)


NEAR = 1_000_000
"""Index from which on scenes are drawn near the published rig, where most bounds of L2 hold."""


def scene_of(index: int) -> Scene:
    """Return the random scene of an index; it is the same whatever was drawn before."""
    rng = np.random.default_rng([21, index])
    return near_scene(rng) if index >= NEAR else random_scene(rng)
