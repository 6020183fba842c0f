"""Guards, the stability map put to use: a failing region is left for the survivor, or the run stops.

Thresholds are those that the study ``contact-stability`` finds; each answer comes with the words for the
record.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics.equilibrium.finders import continued_newton
from palp_core.palpation.mechanics.equilibrium.joint import Joint
from palp_core.palpation.mechanics.equilibrium.sweep import Sweep
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.methods import find
from palp_core.units import Float64Array

STAGE_STEP_MAX_M = 0.001
"""Coarser stage grids miss the peak: about 1 % at 4 mm."""

SMALL_STRAIN_SHARE = 0.5
"""Of the ball's radius and of the gel over the bead; beyond it small strain may be off by a tenth."""

_STRAY_RAD = 1e-6


@dataclass(frozen=True, eq=False)
class Guarded:
    """Angles with the finder that gave them.

    Attributes:
        angle_rad: Joint angles, shape (n,).
        finder: Name of the method that they are from.
        note: What was switched and why; empty if nothing.
    """

    angle_rad: Float64Array
    finder: str
    note: str = ""


def guarded_angles(name: str, joint: Joint, stage_m: Float64Array) -> Guarded:
    """Return a finder's angles where they are the followed equilibrium, else the survivor's and say so.

    Args:
        name: A method of the task ``equilibrium``.
        joint: Balance of moments.
        stage_m: Stage positions in sweep order, forward.

    Raises:
        MethodError: There is no such finder.
        MechanicsError: There is no equilibrium with a lagging tip.
    """
    followed = continued_newton(joint, stage_m)
    if name == "bracketed_newton":
        return Guarded(followed, name)
    try:
        tried: Float64Array = find("equilibrium", name).target(joint, stage_m)
    except (MechanicsError, ValueError, FloatingPointError) as error:
        return Guarded(followed, "bracketed_newton", f"{name} stopped ({error}); bracketed_newton took over")
    wrong = ~(np.abs(tried - followed) <= _STRAY_RAD)
    if not wrong.any():
        return Guarded(tried, name)
    note = (
        f"{name} was wrong at {np.count_nonzero(wrong)} of {wrong.size} positions "
        f"(ring_m = {joint.ring_m:g}); bracketed_newton took over"
    )
    return Guarded(followed, "bracketed_newton", note)


def explicit_step_s(
    inertia_kg_m2: float, regular_m_s: float, friction: float, normal_n: float, arm_m: float
) -> float:
    """Return the longest time step at which explicit smooth friction neither chatters nor blows up.

    A third of 2 I v_r / (mu N A^2), the limit of the linearised law at rest.
    """
    load = friction * normal_n * arm_m**2
    return float("inf") if load <= 0.0 else 2.0 * inertia_kg_m2 * regular_m_s / load / 3.0


def stage_step(step_m: float) -> tuple[float, str]:
    """Return a stage step that does not miss the peak, and what was changed."""
    if step_m <= STAGE_STEP_MAX_M:
        return step_m, ""
    return STAGE_STEP_MAX_M, (f"a stage step of {step_m:g} m misses the peak; {STAGE_STEP_MAX_M:g} m is used")


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
