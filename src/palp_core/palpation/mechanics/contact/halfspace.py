"""The elastic half-space under a uniformly loaded rectangle: Love's closed form."""

import math

import numpy as np

from palp_core.units import Float64Array


def _fourth(x: Float64Array, y: Float64Array) -> Float64Array:
    """Return the antiderivative of 1 / sqrt(x^2 + y^2), twice in x and twice in y."""
    r = np.hypot(x, y)
    ax, ay = np.abs(x), np.abs(y)
    safe_x, safe_y = np.where(ax == 0.0, 1.0, ax), np.where(ay == 0.0, 1.0, ay)
    first = np.where(ay == 0.0, 0.0, 0.5 * ax * ay**2 * np.arcsinh(ax / safe_y))
    second = np.where(ax == 0.0, 0.0, 0.5 * ay * ax**2 * np.arcsinh(ay / safe_x))
    return np.asarray(first + second - r**3 / 6.0)


def love_mean(x_m: Float64Array, y_m: Float64Array, cell_m: float, poisson: float) -> Float64Array:
    """Return the mean sinking over a cell centred at (x, y), under a unit force on one at the origin, E = 1.

    Love, Philosophical Transactions A 228 (1929) 377; Johnson, Contact Mechanics, 1985, equation (3.25). The
    mean is its antiderivative, once more in x and once more in y.

    Args:
        x_m: Distance along, any shape.
        y_m: Distance across, same shape.
        cell_m: Side of the square cells.
        poisson: Poisson's ratio.
    """
    total = np.zeros(np.broadcast(x_m, y_m).shape)
    for i, along in ((-1, 1.0), (0, -2.0), (1, 1.0)):
        for j, across in ((-1, 1.0), (0, -2.0), (1, 1.0)):
            total += along * across * _fourth(x_m + i * cell_m, y_m + j * cell_m)
    return np.asarray(total * (1.0 - poisson**2) / (math.pi * cell_m**4))
