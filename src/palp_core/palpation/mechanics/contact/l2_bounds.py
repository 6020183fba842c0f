"""How wrong rung L2 is, measured against L4: the largest error seen, plus about a third, box by box.

Boxes of geometry nest: the published phantom itself, about it, near it, in its neighbourhood; and so do
loads: the usual one, a wide one, any. L2's bead term was derived for a bead of the ball's own size, so a
smaller bead or a thicker slab costs the most. What becomes of an error of the force depends on how far the
joint gives way (``yielding``, the moment of Hertz's force over what the joint can hold): from 1 on the peak
hardly feels it, at 0.1 it is as wrong as the force. The contrast needs a path that goes far enough past the
bead (``margin_m``). The trace is off where the tip comes down the far flank of a shallow bead. Where the bead
is 2 mm beside the path (``beside_m``) the peak is off by up to twice as much as over it, and the bounds still
hold; from 4 mm on they break. Trace and beads beside the path were measured with the sphere alone.

They hold for a sphere and for a paraboloid: the numbers are the larger of both, from the corners of the boxes
at depths of 1.5 to 8.5 mm. For the paraboloid each had up to 54 loads at four rings, and the published
phantom seventy at twelve depths; for the sphere the worst corners had 128 or 200 loads at four rings, up to
mu = 0.6 and 60 kPa, and the published phantom 200 at seven depths. Random scenes, 200 and 50
near the rig, kept every bound; ``tests/palpation/mechanics/scene/test_picker.py`` repeats some.
"""

from collections.abc import Mapping

from palp_core.methods import Bound

_Range = tuple[float, float]
_Box = Mapping[str, _Range]

_PUBLISHED: _Box = {
    "bead_radius_m": (0.00745, 0.00755),
    "tip_radius_m": (0.00595, 0.00605),
    "height_m": (0.0298, 0.0302),
    "poisson": (0.489, 0.491),
}
_PAPER: _Box = {
    "bead_radius_m": (0.0074, 0.0076),
    "tip_radius_m": (0.0058, 0.0062),
    "height_m": (0.0295, 0.0305),
    "poisson": (0.488, 0.492),
}
_NEAR: _Box = {
    "bead_radius_m": (0.007, 0.008),
    "tip_radius_m": (0.0055, 0.0065),
    "height_m": (0.028, 0.032),
    "poisson": (0.48, 0.495),
}
_ABOUT: _Box = {
    "bead_radius_m": (0.006, 0.009),
    "tip_radius_m": (0.0045, 0.0075),
    "height_m": (0.025, 0.040),
    "poisson": (0.46, 0.4999),
}
_USUAL: _Box = {
    "modulus_pa": (15e3, 40e3),
    "friction": (0.25, 0.45),
    "indentation_m": (0.003, 0.005),
    "tip_mass_kg": (0.002, 0.020),
}
_WIDE: _Box = {
    "modulus_pa": (8e3, 40e3),
    "friction": (0.2, 0.45),
    "indentation_m": (0.0025, 0.005),
    "tip_mass_kg": (0.002, 0.020),
}
_ANY: _Box = {
    "modulus_pa": (3e3, 60e3),
    "friction": (0.2, 0.6),
    "indentation_m": (0.001, 0.005),
    "tip_mass_kg": (0.002, 0.020),
}
_ALL_RINGS = (0.0, 0.016)
_RINGS = (0.004, 0.016)
_DEEPEST_M = 0.012
_ENDLESS = 1e9
_BESIDE, _OVER = (0.0, 0.002), (0.0, 0.0)
_MARGIN = {"margin_m": (0.03, _ENDLESS)}


def _box(output: str, error: float, geometry: _Box, load: _Box, depth_m: _Range, **more: _Range) -> Bound:
    return Bound(output, error, {**geometry, **load, "depth_m": depth_m, "beside_m": _BESIDE, **more})


def _peak(error: float, geometry: _Box, load: _Box, shallowest_m: float, yielding: float) -> Bound:
    depth_m = (shallowest_m, _DEEPEST_M)
    return _box("peak", error, geometry, load, depth_m, ring_m=_ALL_RINGS, yielding=(yielding, _ENDLESS))


def _contrast(
    error: float, geometry: _Box, load: _Box, depth_m: _Range, ring_m: _Range, yielding: float = 0.5
) -> Bound:
    load = {**load, **_MARGIN}
    return _box("contrast", error, geometry, load, depth_m, ring_m=ring_m, yielding=(yielding, _ENDLESS))


def _trace(error: float, geometry: _Box, shallowest_m: float) -> Bound:
    depth_m, yields = (shallowest_m, _DEEPEST_M), (0.75, _ENDLESS)
    return _box("trace", error, geometry, _USUAL, depth_m, ring_m=_ALL_RINGS, yielding=yields)


_PRESSED: _Box = {"indentation_m": (0.0005, 0.005)}

BOUNDS = [
    _box("normal", 0.15, _PAPER, _PRESSED, (0.003, _DEEPEST_M)),
    _box("normal", 0.21, _NEAR, _PRESSED, (0.003, _DEEPEST_M)),
    _box("normal", 0.42, _NEAR, _PRESSED, (0.002, _DEEPEST_M)),
    _peak(0.019, _PUBLISHED, _USUAL, 0.0019, 0.75),
    _peak(0.0125, _PUBLISHED, _USUAL, 0.0029, 0.75),
    _peak(0.022, _PAPER, _USUAL, 0.0019, 0.75),
    _peak(0.015, _PAPER, _USUAL, 0.0029, 0.75),
    _peak(0.010, _PAPER, _USUAL, 0.0015, 1.0),
    _peak(0.018, _NEAR, _USUAL, 0.0015, 1.0),
    _peak(0.037, _NEAR, _USUAL, 0.0019, 0.75),
    _peak(0.028, _PAPER, _USUAL, 0.0015, 0.3),
    _peak(0.016, _NEAR, _WIDE, 0.0015, 1.5),
    _peak(0.057, _NEAR, _ANY, 0.0015, 0.5),
    _peak(0.180, _NEAR, _ANY, 0.0015, 0.2),
    _peak(0.390, _NEAR, _ANY, 0.0015, 0.1),
    _peak(0.041, _ABOUT, _ANY, 0.0015, 1.5),
    _peak(0.126, _ABOUT, _ANY, 0.0015, 0.5),
    _peak(0.380, _ABOUT, _ANY, 0.0015, 0.2),
    _contrast(0.085, _PUBLISHED, _USUAL, (0.0019, 0.0041), _RINGS),
    _contrast(0.095, _PAPER, _USUAL, (0.0019, 0.0041), _RINGS),
    _contrast(0.120, _PAPER, _USUAL, (0.0019, 0.0045), _RINGS),
    _contrast(0.128, _PAPER, _ANY, (0.0015, 0.0041), _RINGS),
    _contrast(0.155, _PAPER, _ANY, (0.0015, 0.0045), _RINGS),
    _contrast(0.220, _PAPER, _ANY, (0.0019, 0.0045), _ALL_RINGS),
    _contrast(0.325, _PAPER, _ANY, (0.0015, 0.0085), _RINGS),
    _contrast(0.405, _PAPER, _ANY, (0.0015, 0.0085), _ALL_RINGS),
    _contrast(0.180, _NEAR, _USUAL, (0.0019, 0.0045), _RINGS),
    _contrast(0.215, _NEAR, _ANY, (0.0015, 0.0045), _RINGS),
    _contrast(0.285, _NEAR, _ANY, (0.0015, 0.0045), _ALL_RINGS),
    _contrast(0.475, _NEAR, _ANY, (0.0015, 0.0085), _RINGS),
    _contrast(0.555, _NEAR, _ANY, (0.0015, 0.0085), _ALL_RINGS),
    _contrast(0.545, _ABOUT, _ANY, (0.0015, 0.0045), _ALL_RINGS),
    _trace(0.205, _PAPER, 0.0019),
    _trace(0.081, _PAPER, 0.0029),
    _trace(0.0195, _PAPER, 0.0059),
    _box(
        "separation",
        0.250,
        _PAPER,
        _WIDE,
        (0.0015, 0.0085),
        ring_m=_RINGS,
        beside_m=_OVER,
        depth_ratio=(1.3, _ENDLESS),
        yielding=(0.75, _ENDLESS),
    ),
    _box(
        "separation",
        0.530,
        _PAPER,
        _WIDE,
        (0.0015, _DEEPEST_M),
        ring_m=_ALL_RINGS,
        beside_m=_OVER,
        depth_ratio=(1.15, _ENDLESS),
        yielding=(0.5, _ENDLESS),
    ),
    _box(
        "decision",
        0.100,
        _PAPER,
        _WIDE,
        (0.0015, _DEEPEST_M),
        ring_m=_ALL_RINGS,
        beside_m=_OVER,
        depth_ratio=(1.15, _ENDLESS),
        yielding=(0.5, _ENDLESS),
    ),
]
"""Stated errors of L2."""
