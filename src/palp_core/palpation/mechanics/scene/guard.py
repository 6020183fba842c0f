"""Guards, the stability map put to use: they mark a sweep that met what its method may fail at.

They replace nothing: a run keeps its methods. Thresholds are those that the study ``stability``
finds; each answer comes with the words for the record.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from palp_core.methods import Method, MethodChoice, find

if TYPE_CHECKING:
    from palp_core.palpation.mechanics.equilibrium.sweep import Sweep
    from palp_core.palpation.mechanics.phantom import Phantom
    from palp_core.palpation.mechanics.probe import Probe

SMALL_STRAIN_SHARE = 0.5
"""Of the ball's radius and of the gel over the bead; beyond it small strain may be off by a twentieth."""

BARE_GEL_SHARE = 0.45
"""Of the ball's radius, on gel without a bead; beyond it small strain is off by a twentieth."""

_TWENTIETH = 0.05


def sweep_guards(phantom: Phantom, probe: Probe, rung: str, solved: Sweep) -> tuple[str, ...]:
    """Return what a sweep met that its record must say, the rung's failing regions included."""
    words = list(solved.guards)
    if not states_finite_strain(find("contact", rung)):
        words += _small_strain(phantom, probe, solved)
    return tuple(words)


def states_finite_strain(declared: Method) -> bool:
    """Return whether a rung states its normal force within a twentieth of that at finite strain."""
    return any(one.output == "finite_normal" and one.error <= _TWENTIETH for one in declared.bounds)


def _small_strain(phantom: Phantom, probe: Probe, solved: Sweep) -> list[str]:
    bead = phantom.bead
    if bead is None:
        deepest_m = float(solved.indentation_m.max(initial=0.0))
        if deepest_m <= BARE_GEL_SHARE * probe.tip_radius_m:
            return []
        return [
            f"small strain: {deepest_m * 1e3:.2g} mm pressed into bare gel by a ball of "
            f"{probe.tip_radius_m * 1e3:.2g} mm; finite strain (l5) differs by a twentieth and more"
        ]
    over = np.abs(solved.offset_m) <= bead.radius_m
    deepest_m = float(solved.indentation_m[over].max()) if over.any() else 0.0
    if deepest_m <= SMALL_STRAIN_SHARE * min(bead.depth_m, probe.tip_radius_m):
        return []
    return [
        f"small strain: {deepest_m * 1e3:.2g} mm pressed into {bead.depth_m * 1e3:.2g} mm of gel "
        "over the bead; finite strain (l5) may differ by a twentieth and more"
    ]


def speed_guard(motion: MethodChoice) -> tuple[str, ...]:
    """Return what to say where inertia is left out and the stage sweeps faster than that is bounded."""
    if motion.bound is not None and motion.bound <= motion.tolerance:
        return ()
    own = next(one for one in motion.candidates if one.name == motion.name)
    return (f"inertia: {motion.name}: {own.why}",)


def task_of(words: str) -> str:
    """Return the task whose method a guard's words are about.

    >>> task_of("small strain: 2 mm pressed into 2 mm of gel"), task_of("2 snap(s): the torque jumps")
    ('contact', 'motion')
    """
    return "contact" if words.startswith("small strain:") else "motion"
