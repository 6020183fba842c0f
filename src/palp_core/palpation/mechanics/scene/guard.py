"""Guards, the stability map put to use: a failing region is left for the survivor, or the run stops.

Thresholds are those that the study ``contact-stability`` finds; each answer comes with the words for the
record.
"""

import numpy as np

from palp_core.palpation.mechanics.equilibrium.sweep import Sweep
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.palpation.mechanics.probe import Probe

SMALL_STRAIN_SHARE = 0.5
"""Of the ball's radius and of the gel over the bead; beyond it small strain may be off by a twentieth."""

_PARABOLOIDS = ("l1", "l3")
"""Rungs that know no other form of the ball."""


def sweep_guards(phantom: Phantom, probe: Probe, rung: str, solved: Sweep) -> tuple[str, ...]:
    """Return what a sweep met that its record must say, the rung's failing regions included."""
    words = list(solved.guards)
    if rung in _PARABOLOIDS and probe.tip != "paraboloid":
        words.append(f"{rung} takes the {probe.tip} for a paraboloid; l2, l4 and l5 take it as it is")
    bead = phantom.bead
    if bead is not None and rung != "l5":
        over = np.abs(solved.offset_m) <= bead.radius_m
        deepest_m = float(solved.indentation_m[over].max()) if over.any() else 0.0
        if deepest_m > SMALL_STRAIN_SHARE * min(bead.depth_m, probe.tip_radius_m):
            words.append(
                f"small strain: {deepest_m * 1e3:.2g} mm pressed into {bead.depth_m * 1e3:.2g} mm of gel "
                "over the bead; finite strain (l5) may differ by a twentieth and more"
            )
    return tuple(words)
