"""How wrong rung L2 is, measured against L4: the largest error seen, plus about a third, box by box.

The boxes nest: about the paper's phantom, near it, in its neighbourhood; and the usual load, a wide one,
any. L2's
bead term was derived for a bead of the ball's own size, so a smaller bead or a thicker slab costs the most.
The
numbers are from 230 random geometries with six loads and five ring positions each; the study
``contact-validity`` draws others and must find every bound kept.
"""

from __future__ import annotations

from collections.abc import Mapping

from palp_core.methods import Bound

__all__ = ["BOUNDS"]

_Box = Mapping[str, tuple[float, float]]

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
    "friction": (0.1, 0.6),
    "indentation_m": (0.001, 0.005),
    "tip_mass_kg": (0.002, 0.020),
}
_ALL_RINGS = (0.0, 0.016)
_RINGS = (0.004, 0.016)
_DEPTHS = (0.0015, 0.012)


def _bound(
    output: str,
    error: float,
    geometry: _Box,
    load: _Box,
    depth_m: tuple[float, float] = _DEPTHS,
    ring_m: tuple[float, float] = _ALL_RINGS,
    depth_ratio: tuple[float, float] | None = None,
) -> Bound:
    apart = {} if depth_ratio is None else {"depth_ratio": depth_ratio}
    return Bound(output, error, {**geometry, **load, "depth_m": depth_m, "ring_m": ring_m, **apart})


_PRESSED: _Box = {"indentation_m": (0.0005, 0.005)}

BOUNDS = [
    _bound("normal", 0.15, _PAPER, _PRESSED, (0.003, 0.012)),
    _bound("normal", 0.21, _NEAR, _PRESSED, (0.003, 0.012)),
    _bound("normal", 0.42, _NEAR, _PRESSED, (0.002, 0.012)),
    _bound("peak", 0.010, _PAPER, _USUAL),
    _bound("peak", 0.014, _NEAR, _USUAL),
    _bound("peak", 0.040, _NEAR, _WIDE),
    _bound("peak", 0.180, _NEAR, _ANY),
    _bound("peak", 0.220, _ABOUT, _ANY),
    _bound("contrast", 0.065, _PAPER, _WIDE, (0.0015, 0.0045), _RINGS),
    _bound("contrast", 0.090, _NEAR, _WIDE, (0.0015, 0.0045), _RINGS),
    _bound("contrast", 0.150, _NEAR, _WIDE, (0.0015, 0.0045)),
    _bound("contrast", 0.180, _PAPER, _WIDE, (0.0015, 0.0085), _RINGS),
    _bound("contrast", 0.200, _NEAR, _WIDE, (0.0015, 0.006), _RINGS),
    _bound("contrast", 0.240, _NEAR, _WIDE, (0.0015, 0.0085), _RINGS),
    _bound("contrast", 0.300, _NEAR, _WIDE, (0.0015, 0.0085)),
    _bound("contrast", 0.300, _ABOUT, _ANY, (0.0015, 0.004)),
    _bound("separation", 0.200, _PAPER, _WIDE, (0.0015, 0.0085), _RINGS, (1.3, 1e3)),
    _bound("separation", 0.400, _PAPER, _WIDE, _DEPTHS, _ALL_RINGS, (1.15, 1e3)),
    _bound("decision", 0.100, _PAPER, _WIDE, _DEPTHS, _ALL_RINGS, (1.15, 1e3)),
]
"""Stated errors of L2."""
