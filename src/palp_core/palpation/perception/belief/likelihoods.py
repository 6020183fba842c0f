"""Log densities of one reading for a depth and ring position; task ``likelihood``.

Every function takes the cells of one setting and returns natural-log densities, one per class, finite for any
finite reading of physical size. Readings of shape (n, 1) with cells of shape (n, m) give n rows at once.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from palp_core.units import Float64Array

_LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class Cells:
    """The memory primitives of one setting."""

    mean: Float64Array  # Mean reading per class, any unit, shape (m,)
    sd: Float64Array  # Standard deviation per class, positive, shape (m,)
    count: Float64Array  # Training readings per class, shape (m,)
    floor: float  # Smallest standard deviation the sensor can show


def normal(reading: float | Float64Array, cells: Cells) -> Float64Array:
    """Return log N(reading; mean, sd): the normal fitted to the training readings, as if known exactly."""
    z = (reading - cells.mean) / cells.sd
    return np.asarray(-0.5 * (z * z + _LOG_2PI) - np.log(cells.sd))


def student_t(reading: float | Float64Array, cells: Cells) -> Float64Array:
    """Return the log predictive density when mean and variance were themselves estimated.

    The posterior predictive of a normal with one prior pseudo-reading of variance floor^2
    (normal-inverse-gamma): Student-t with n degrees of freedom and squared scale ((n - 1) sd^2 + floor^2) / n
    (1 + 1/n), so that a cell of one reading, or of equal ones, still has a density.
    """
    count = cells.count
    variance = ((count - 1.0) * cells.sd**2 + cells.floor**2) / count
    scale = np.sqrt(variance * (1.0 + 1.0 / count))
    z = (reading - cells.mean) / scale
    constant = (
        scipy.special.gammaln(0.5 * (count + 1.0))
        - scipy.special.gammaln(0.5 * count)
        - 0.5 * np.log(count * np.pi)
    )
    return np.asarray(constant - np.log(scale) - 0.5 * (count + 1.0) * np.log1p(z * z / count))
