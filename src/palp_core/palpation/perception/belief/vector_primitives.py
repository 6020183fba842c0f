"""Memory primitives of readings with several columns: P(reading | class, setting), classes of any kind.

The scalar cells of :mod:`primitives` have depths and rings in metres, travel in messages and are
interpolated; these have names alone. Column by column the densities are the same ones, of task
``likelihood``; where the columns of a cell may be correlated, they are the multivariate forms of the normal
and of Student's t.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.methods import find
from palp_core.palpation.perception.belief.likelihoods import Cells
from palp_core.units import Float64Array

_LOG_2PI = float(np.log(2.0 * np.pi))
_SINGULAR = 1e-10  # least eigenvalue of a correlation matrix: below it columns are functions of each other
_ROUNDING = 1e-9  # of a column's range: readings nearer to each other are equal


@dataclass(frozen=True, eq=False)
class VectorPrimitives:
    """A normal in f dimensions per class and setting.

    Attributes:
        mean: Mean reading, any unit per column, shape (m, k, f): classes, settings, columns.
        cov: Covariance, shape (m, k, f, f); of a diagonal fit zero off the diagonal.
        count: Training readings, shape (m, k); NaN means and covariances where it is 0.
        floor: Least standard deviation per column, shape (f,).
        full: Whether the columns of a cell may be correlated.
    """

    mean: Float64Array
    cov: Float64Array
    count: Float64Array
    floor: Float64Array
    full: bool

    def log_likelihood(
        self, reading: Float64Array, setting_index: int, *, model: str = "normal"
    ) -> Float64Array:
        """Return log P(reading | class, setting) for every class, shape (m,).

        Args:
            reading: The new reading, shape (f,), or (n, f) for n rows of densities at once.
            setting_index: Which setting it was taken at.
            model: A method of task ``likelihood``; for correlated columns ``normal`` or ``student_t``.

        Raises:
            PerceptionError: The reading is not finite, a class was not felt at the setting, or the model
                knows single columns only.
            MethodError: No such model.
        """
        values = np.asarray(reading, dtype=np.float64)
        if not np.isfinite(values).all():
            raise PerceptionError(f"reading is {values.tolist()}; drop it")
        if (self.count[:, setting_index] < 1).any():
            raise PerceptionError(f"setting {setting_index} was not felt with every class")
        target = find("likelihood", model).target
        if self.full and self.floor.size > 1:
            return self._correlated(values, setting_index, model)
        k, sd = setting_index, np.sqrt(np.diagonal(self.cov, axis1=-2, axis2=-1))
        columns = [
            target(
                values[..., c, None],
                Cells(self.mean[:, k, c], sd[:, k, c], self.count[:, k], float(self.floor[c])),
            )
            for c in range(self.floor.size)
        ]
        return np.asarray(np.sum(columns, axis=0))

    def _correlated(self, values: Float64Array, k: int, model: str) -> Float64Array:
        if model not in _CORRELATED:
            raise PerceptionError(
                f"likelihood '{model}' knows single columns, not correlated ones; "
                f"use a diagonal covariance, or one of {', '.join(_CORRELATED)}"
            )
        away = values[..., None, :] - self.mean[:, k]
        return _CORRELATED[model](away, self.cov[:, k], self.count[:, k], self.floor)


Correlated = Callable[[Float64Array, Float64Array, Float64Array, Float64Array], Float64Array]


def _normal(
    away: Float64Array, cov: Float64Array, _count: Float64Array, _floor: Float64Array
) -> Float64Array:
    """Return log N(away; 0, cov), shape (..., m), of distances from the means (..., m, f)."""
    squared, log_root = _distance(away, cov)
    return np.asarray(-0.5 * (squared + away.shape[-1] * _LOG_2PI) - log_root)


def _student_t(
    away: Float64Array, cov: Float64Array, count: Float64Array, floor: Float64Array
) -> Float64Array:
    """Return the log predictive density when mean and covariance were themselves estimated.

    Normal-inverse-Wishart with one prior pseudo-reading of variances floor^2, as the scalar one: Student's t
    with n - f + 1 degrees of freedom (Gelman et al., "Bayesian Data Analysis", 3rd ed., sec. 3.6).
    """
    size = away.shape[-1]
    freedom = count - size + 1.0
    scatter = (count - 1.0)[:, None, None] * cov + np.diag(floor**2)
    scale = scatter * ((1.0 + 1.0 / count) / freedom)[:, None, None]
    squared, log_root = _distance(away, scale)
    constant = (
        scipy.special.gammaln(0.5 * (freedom + size))
        - scipy.special.gammaln(0.5 * freedom)
        - 0.5 * size * np.log(freedom * np.pi)
    )
    return np.asarray(constant - log_root - 0.5 * (freedom + size) * np.log1p(squared / freedom))


_CORRELATED: Mapping[str, Correlated] = {"normal": _normal, "student_t": _student_t}


def _distance(away: Float64Array, cov: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return squared Mahalanobis distances (..., m) and the logs of the roots of the determinants (m,)."""
    root = np.linalg.cholesky(cov)
    straight = np.linalg.solve(root, away[..., None])[..., 0]
    return (straight**2).sum(axis=-1), np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum(axis=-1)


def column_floor(values: Float64Array) -> Float64Array:
    """Return the least standard deviation that columns of readings can show, shape (f,).

    The least step between two different readings of a column, over sqrt(12): rounding to such steps.

    Args:
        values: Readings, shape (n, f).

    Raises:
        PerceptionError: All readings of a column are equal.
    """
    found = []
    for number, column in enumerate(values.T):
        steps = np.diff(np.unique(column))
        steps = steps[steps > _ROUNDING * np.ptp(column)] if steps.size else steps
        if not steps.size:
            raise PerceptionError(f"all readings of column {number} are {column[0]:g}; it tells nothing")
        found.append(steps.min() / np.sqrt(12.0))
    return np.array(found)


def fit_vectors(
    values: Float64Array,
    class_index: NDArray[np.int64],
    setting_index: NDArray[np.int64],
    *,
    shape: tuple[int, int],
    floor: Float64Array,
    full: bool,
) -> VectorPrimitives:
    """Fit mean and unbiased covariance to the readings of every cell that has two or more.

    Args:
        values: Training readings, shape (n, f).
        class_index: Class of each, shape (n,).
        setting_index: Setting of each, shape (n,).
        shape: Number of classes and of settings.
        floor: Least standard deviation per column, shape (f,).
        full: Whether the columns of a cell may be correlated; wants more readings a cell than columns.

    Returns:
        The primitives; of a cell with fewer readings than the fit wants, the count is 0.

    Raises:
        PerceptionError: A column of a cell is a function of the others.
    """
    columns = values.shape[1]
    cell = class_index * shape[1] + setting_index
    cells = shape[0] * shape[1]
    count = np.bincount(cell, minlength=cells).astype(np.float64)
    count[count < (columns + 1 if full else 2)] = 0.0
    known = np.where(count > 0.0, count, np.nan)
    mean = (
        np.stack([np.bincount(cell, weights=c, minlength=cells) for c in values.T], axis=-1) / known[:, None]
    )
    away = values - mean[cell]
    cov = np.zeros((cells, columns, columns))
    for i in range(columns):
        for j in range(i, columns if full else i + 1):
            product = np.bincount(cell, weights=away[:, i] * away[:, j], minlength=cells) / (known - 1.0)
            cov[:, i, j] = cov[:, j, i] = product
    for i in range(columns):
        cov[:, i, i] = np.maximum(cov[:, i, i], floor[i] ** 2)
    found = VectorPrimitives(
        mean.reshape(*shape, columns),
        cov.reshape(*shape, columns, columns),
        count.reshape(shape),
        floor,
        full,
    )
    if full:
        _require_rank(found)
    return found


def _require_rank(found: VectorPrimitives) -> None:
    sd = np.sqrt(np.diagonal(found.cov, axis1=-2, axis2=-1))
    of = found.count > 0.0
    correlation = found.cov[of] / (sd[of][:, :, None] * sd[of][:, None, :])
    if correlation.size and np.linalg.eigvalsh(correlation).min() < _SINGULAR:
        raise PerceptionError(
            "in a cell one column of the readings is a function of the others; leave it out, or use a "
            "diagonal covariance"
        )
