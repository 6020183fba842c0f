"""Roots of many scalar functions at once: Newton kept inside a bracket, and a polish from a good guess."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import MechanicsError
from palp_core.units import Float64Array

Function = Callable[[Float64Array], Float64Array]

_EPSILON = float(np.finfo(np.float64).eps)
_ITERATIONS = 100
_PROBE = 1e-7  # of the difference quotient; Newton's last steps are secants, so its error does not stay
_POLISH_STEPS = 8


def bracketed_newton(
    function: Function, low: Float64Array, high: Float64Array, start: Float64Array | None = None
) -> Float64Array:
    """Return one root per bracket: Newton where it stays inside and halves the bracket, else bisection."""
    low, high = low.copy(), high.copy()
    at = 0.5 * (low + high) if start is None else np.clip(start, low, high)
    width = high - low
    for _ in range(_ITERATIONS):
        value = function(at)
        if not np.all(np.isfinite(value)):
            raise MechanicsError(
                "the joint's angle did not converge; is the contact force a number everywhere?"
            )
        below = value < 0.0
        low, high = np.where(below, at, low), np.where(below, high, at)
        probe = np.where(at + _PROBE < high, _PROBE, -_PROBE)
        slope = (function(at + probe) - value) / probe
        step = np.divide(value, slope, out=np.full_like(value, np.inf), where=slope > 0.0)
        new = at - step
        slow = high - low > 0.5 * width
        outside = ~((new > low) & (new < high)) | (slow & (np.abs(step) > 0.25 * width))
        new = np.where(outside, 0.5 * (low + high), new)
        done = (np.abs(new - at) <= 2.0 * _EPSILON * (1.0 + np.abs(at))) | (value == 0.0)
        width = high - low
        at = np.where(value == 0.0, at, new)
        if np.all(done | (width <= 4.0 * _EPSILON)):
            return at
    return at


def polish(
    function: Function, guess: Float64Array, slope: Float64Array, reach: float
) -> tuple[Float64Array, NDArray[np.bool_]]:
    """Improve good guesses to round-off by secant steps, and return which stayed near and converged.

    Returns:
        The roots, and where they can be trusted: converged, within reach, at a rising zero.
    """
    before, value_before = guess, function(guess)
    step = -value_before / slope
    for _ in range(_POLISH_STEPS):
        at = before + np.clip(step, -reach, reach)
        value = function(at)
        moved = at - before
        wide = np.abs(moved) > 1e-9  # closer points give no slope, only round-off
        slope = np.where(wide, np.divide(value - value_before, moved, out=slope.copy(), where=wide), slope)
        step = np.divide(-value, slope, out=np.full_like(value, np.inf), where=slope > 0.0)
        before, value_before = at, value
        if np.all(np.abs(step) <= 2e-14):
            break
    settled = np.isfinite(step) & (np.abs(step) <= 1e-12) & (np.abs(before - guess) <= reach)
    return np.where(settled, before + np.where(settled, step, 0.0), before), settled


def inverse_guess(values: Float64Array, cell: NDArray[np.int64], step: np.float64) -> Float64Array:
    """Return where sampled functions cross zero, by inverse interpolation through up to four samples."""
    rows = np.arange(len(values))
    left, right = values[rows, cell], values[rows, cell + 1]
    linear = left / (left - right)
    first = np.clip(cell - 1, 0, values.shape[1] - 4)
    nodes = np.stack([values[rows, first + k] for k in range(4)])
    total = np.zeros(len(values))
    with np.errstate(divide="ignore", invalid="ignore"):
        for k in range(4):
            term = (first + k - cell).astype(np.float64)
            for other in range(4):
                if other != k:
                    term = term * nodes[other] / (nodes[other] - nodes[k])
            total += term
    crossing: Float64Array = step * (cell + np.where((total >= 0.0) & (total <= 1.0), total, linear))
    return crossing
