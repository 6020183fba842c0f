"""Guards, the stability map put to use: a failing region is left for the survivor, or the run stops.

Thresholds are those that the study ``contact-stability`` finds; each answer comes with the words for the
record.
"""

import numpy as np

from palp_core.palpation.mechanics.equilibrium.sweep import Sweep
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.methods import find

SMALL_STRAIN_SHARE = 0.5
"""Of the ball's radius and of the gel over the bead; beyond it small strain may be off by a tenth."""


def outside(task: str, name: str, scene: Scene) -> str:
    """Return which quantities of a scene lie outside a method's valid range, in words; empty if none."""
    declared, quantities = find(task, name), scene.quantities()
    strayed = []
    for quantity, (low, high) in declared.valid.items():
        given = quantities.get(quantity)
        values = given if isinstance(given, tuple) else () if given is None else (given,)
        if any(not low <= value <= high for value in values):
            strayed.append(f"{quantity} not in [{low:g}, {high:g}]")
    if not strayed:
        return ""
    advice = f"; {declared.survivor} survives there" if declared.survivor else ""
    return f"{name} is outside its valid range: {', '.join(strayed)}{advice}"


def sweep_guards(phantom: Phantom, probe: Probe, rung: str, solved: Sweep) -> tuple[str, ...]:
    """Return what a sweep met that its record must say, the rung's failing regions included."""
    words = list(solved.guards)
    bead = phantom.bead
    if bead is not None and rung != "l5":
        over = np.abs(solved.offset_m) <= bead.radius_m
        deepest_m = float(solved.indentation_m[over].max()) if over.any() else 0.0
        if deepest_m > SMALL_STRAIN_SHARE * min(bead.depth_m, probe.tip_radius_m):
            words.append(
                f"small strain: {deepest_m * 1e3:.2g} mm pressed into {bead.depth_m * 1e3:.2g} mm of gel "
                "over the bead; finite strain (l5) may differ by a tenth and more"
            )
    return tuple(words)
