"""Bounds of what goes in: numbers refused by name and with advice, and steps that are fine enough."""

import math

import numpy as np
from numpy.typing import ArrayLike

from palp_core.errors import OutOfRange
from palp_core.units import Float64Array

STAGE_STEP_MAX_M = 0.001
"""Coarser stage grids miss the peak: about 1 % at 4 mm."""


def require(quantity: str, value: float, low: float, high: float, advice: str) -> None:
    """Check that a quantity is a number within inclusive bounds."""
    if not (math.isfinite(value) and low <= value <= high):
        raise OutOfRange(quantity, f"{value:g} is not in [{low:g}, {high:g}]; {advice}")


def finite_offsets(offset_m: ArrayLike) -> Float64Array:
    """Return lateral offsets as an array, any shape."""
    offsets = np.asarray(offset_m, dtype=np.float64)
    if not np.isfinite(offsets).all():
        raise OutOfRange("offset_m", "an offset is not a number; give metres from the bead, as in 0.01")
    return offsets


def finite_places(
    offset_m: ArrayLike, indentation_m: ArrayLike, deepest_m: float, advice: str
) -> tuple[Float64Array, Float64Array]:
    """Return offsets and indentations as arrays, once the former are finite and the latter not too deep."""
    depths = np.asarray(indentation_m, dtype=np.float64)
    if not (depths <= deepest_m).all():
        raise OutOfRange("indentation_m", f"{np.max(depths):g} is beyond {deepest_m:g}, {advice}")
    return finite_offsets(offset_m), depths


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
