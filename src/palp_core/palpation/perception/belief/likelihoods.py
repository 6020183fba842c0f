"""Log densities of one reading given a cell of memory primitives; exchangeable, task ``likelihood``.

Every function takes the cells of one setting and returns natural-log densities, one per class, finite for any
finite reading of physical size. Readings of shape (n, 1) with cells of shape (n, m) give n rows at once.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from palp_core.methods import Bound, declare_task, method
from palp_core.palpation.perception.ranges import ENDLESS
from palp_core.units import Float64Array

_LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class Cells:
    """The memory primitives of one setting."""

    mean: Float64Array  # Mean reading per class, any unit, shape (m,)
    sd: Float64Array  # Standard deviation per class, positive, shape (m,)
    count: Float64Array  # Training readings per class, shape (m,)
    floor: float  # Smallest standard deviation the sensor can show


def _taught(outlier_share: float, *errors: float) -> list[Bound]:
    """Return bounds on the calibration error for 25, 10, 5 and 3 training readings a class and more.

    They are of trials that end at a probability of 0.95 or after 15 readings, classes being two standard
    deviations of a reading apart or more.
    """
    return [
        Bound(
            "calibration",
            error,
            {
                "training_count": (count, ENDLESS),
                "class_gap_sd": (2.0, ENDLESS),
                "class_count": (2.0, 3.0),
                "probe_count": (1.0, 15.0),
                "outlier_share": (0.0, outlier_share),
            },
        )
        for count, error in zip((25.0, 10.0, 5.0, 3.0), errors, strict=True)
    ]


declare_task(
    "likelihood",
    "How likely is a reading, given what training taught?",
    per="a reading",
    output="calibration",
    tolerance=0.05,
)


@method(
    task="likelihood",
    name="normal",
    cost_s=5e-6,
    bounds=[*_taught(0.0, 0.018, 0.043, 0.118, 0.235), *_taught(0.01, 0.037, 0.066, 0.14, 0.256)],
    evidence="tests/palpation/studies/perception/test_method_bounds.py",
    fails="cells of few readings, and outliers: it is sure of whatever class is nearest",
    survivor="student_t",
)
def normal(reading: float | Float64Array, cells: Cells) -> Float64Array:
    """Return log N(reading; mean, sd): the normal fitted to the training readings, as if known exactly."""
    z = (reading - cells.mean) / cells.sd
    return np.asarray(-0.5 * (z * z + _LOG_2PI) - np.log(cells.sd))


@method(
    task="likelihood",
    name="student_t",
    cost_s=1.3e-5,
    bounds=[*_taught(0.0, 0.008, 0.018, 0.055, 0.128), *_taught(0.01, 0.02, 0.025, 0.061, 0.132)],
    evidence="tests/palpation/studies/perception/test_method_bounds.py",
    fails="readings of one trial that share an error: it widens for the training's size only",
)
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
