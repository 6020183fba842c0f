"""How wrong the contact rungs are against finite strain: bounds on ``finite_peak`` and its like.

Each is the largest error seen, plus about a third, for a sphere on the published phantom and on phantoms
within 2 % of its lengths, where the tip goes no deeper than 0.74 of the ball's radius and of the gel over the
bead (``pressed_share``; beyond it L5's elements may fold).

L5 is held against finite elements in three dimensions, over and beside beads under 4 and 8 mm of gel. L2 and
L4 are held against L5, on 34 phantoms with 48 loads each; what L5 may be off is added. That L2's contrast is
nearer than L4's is luck: it is too stiff over the bead, as the gel is at finite strain.
"""

from collections.abc import Mapping

from palp_core.methods import Bound

PRESSED_MAX = 0.74
"""Of the ball's radius and of the gel over the bead: how deep L5 was seen to reach everywhere."""

_Range = tuple[float, float]
_Box = Mapping[str, _Range]

_ENDLESS = 1e9
_GEOMETRY: _Box = {
    "bead_radius_m": (0.0074, 0.0076),
    "tip_radius_m": (0.0058, 0.0062),
    "height_m": (0.0295, 0.0305),
    "poisson": (0.488, 0.492),
    "pressed_share": (0.0, PRESSED_MAX),
    "beside_m": (0.0, 0.0),
}
_LOAD: _Box = {
    "modulus_pa": (8e3, 40e3),
    "friction": (0.25, 0.45),
    "tip_mass_kg": (0.002, 0.020),
    "indentation_m": (0.002, 0.005),
    "ring_m": (0.004, 0.016),
}
_SHALLOW: _Box = {"beads": (1.0, 1.0), "depth_m": (0.0019, 0.0045)}
_BEAD: _Box = {"beads": (1.0, 1.0), "depth_m": (0.0019, 0.0085)}
_ANY: _Box = {"depth_m": (0.0019, 0.012)}  # bare gel too


def _normal(error: float) -> Bound:
    return Bound("finite_normal", error, {**_GEOMETRY, **_ANY})


def _peak(error: float, where: _Box, yielding: float) -> Bound:
    more = {"yielding": (yielding, _ENDLESS)}
    return Bound("finite_peak", error, {**_GEOMETRY, **_LOAD, **where, **more})


def _contrast(error: float, where: _Box, stiffest_pa: float = 40e3) -> Bound:
    more = {"margin_m": (0.03, _ENDLESS), "modulus_pa": (8e3, stiffest_pa)}
    return Bound("finite_contrast", error, {**_GEOMETRY, **_LOAD, **where, **more})


L2 = [
    _normal(0.17),
    _peak(0.010, _SHALLOW, 0.75),
    _peak(0.021, _ANY, 0.75),
    _peak(0.017, _SHALLOW, 0.3),
    _peak(0.046, _ANY, 0.3),
    _contrast(0.115, _SHALLOW),
    _contrast(0.280, _BEAD),
]
"""Stated errors of L2 against finite strain."""

L4 = [
    _normal(0.11),
    _peak(0.007, _SHALLOW, 0.75),
    _peak(0.021, _ANY, 0.75),
    _peak(0.010, _SHALLOW, 0.3),
    _peak(0.052, _ANY, 0.3),
    _contrast(0.175, _SHALLOW),
    _contrast(0.320, _BEAD),
]
"""Stated errors of L4 against finite strain."""

L5 = [
    _normal(0.012),
    _peak(0.004, _ANY, 0.1),
    _contrast(0.020, _SHALLOW),
    _contrast(0.057, _BEAD, 25e3),
    _contrast(0.105, _BEAD),
]
"""Stated errors of L5 against finite elements in three dimensions."""
