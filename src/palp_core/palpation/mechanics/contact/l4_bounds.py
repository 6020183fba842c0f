"""How wrong rung L4 is at its usual cells of 1 mm, measured against cells of 0.5 mm on the same elements.

The largest error seen, plus about a third. What is wrong is where the contact ends between two cells: some
0.3 % of the force, another share over the bead than beside it. The peak hardly feels it, as the joint yields,
but for a gel so soft that it does not. The contrast is the small difference of two such forces, the smaller
the deeper the bead; a gel so stiff that the tip all but lifts off leaves even less of it. Of two depths the
gap between the peaks is likewise a difference, the smaller the closer they are.

The numbers are from 250 random scenes and from the published phantom at twelve depths with
seventy loads and rings each. Elements twice as fine around the bead and cells of 0.35 mm change the force by
less than 0.7 %.
"""

from palp_core.methods import Bound

_GEL = (500.0, 500e3)
_CROSSED = {"margin_m": (0.02, 1e9)}  # nearer the bead a path ends before the peak, or under it
_NEAR = {"beside_m": (0.0, 0.006)}  # further beside the path the contrast is next to nothing
_OVER = {"beside_m": (0.0, 0.0)}
_TRACED = {"depth_m": (0.0015, 0.015), **_NEAR}
_PUBLISHED = {
    "bead_radius_m": (0.0074, 0.0076),
    "tip_radius_m": (0.0058, 0.0062),
    "height_m": (0.0295, 0.0305),
    "poisson": (0.488, 0.492),
    "modulus_pa": (5e3, 40e3),
}

BOUNDS = [
    Bound("normal", 0.013),
    Bound("peak", 0.005, within={"modulus_pa": (15e3, 1e9)}),
    Bound("peak", 0.008),
    Bound("contrast", 0.02, within={"depth_m": (0.0, 0.0082), **_PUBLISHED, **_CROSSED, **_NEAR}),
    Bound("contrast", 0.02, within={"depth_m": (0.0, 0.005), "modulus_pa": _GEL, **_CROSSED, **_NEAR}),
    Bound("contrast", 0.026, within={"depth_m": (0.0, 0.0085), "modulus_pa": _GEL, **_CROSSED, **_NEAR}),
    Bound("contrast", 0.05, within={"margin_m": (0.016, 1e9), **_NEAR}),
    Bound("trace", 0.016, within={"modulus_pa": (15e3, 1e9), **_TRACED}),
    Bound("trace", 0.019, within={"modulus_pa": (8e3, 1e9), **_TRACED}),
    Bound("trace", 0.09, within={"modulus_pa": (5e3, 1e9), **_TRACED}),
    Bound("separation", 0.04, within={"depth_ratio": (2.0, 1e3), "modulus_pa": _GEL, **_OVER}),
    Bound("separation", 0.06, within={"depth_ratio": (1.3, 1e3), **_OVER}),
    Bound("decision", 0.01, within={"depth_ratio": (1.3, 1e3), **_OVER}),
]
"""Stated errors of L4."""
