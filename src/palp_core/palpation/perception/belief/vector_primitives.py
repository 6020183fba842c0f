"""Memory primitives of vector readings: several features a palpation, with their covariance.

As :mod:`primitives`, for f features: a multivariate normal per class and setting, or the Student-t of a
posterior predictive. Peak and contrast jointly are such a reading, and so are another rig's tactile features.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from palp_core.errors import PerceptionError
from palp_core.palpation.methods import find, method
from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class VectorCells:
    """The primitives of one setting.

    Attributes:
        mean: Mean reading per class, shape (m, f).
        cov: Covariance per class, positive definite, shape (m, f, f).
        count: Training readings per class, shape (m,).
        floor: Least standard deviation of each feature, shape (f,).
    """

    mean: Float64Array
    cov: Float64Array
    count: Float64Array
    floor: Float64Array


def _distance(
    reading: Float64Array, mean: Float64Array, cov: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return the squared Mahalanobis distance and the log determinant per class, shapes (..., m)."""
    away = reading[..., None, :] - mean
    weighed = np.linalg.solve(cov, away[..., None])[..., 0]
    return np.asarray((away * weighed).sum(axis=-1)), np.asarray(np.linalg.slogdet(cov)[1])


@method(
    task="likelihood_vector",
    name="normal_vector",
    cost_s=2e-5,
    evidence="tests/palpation/perception/belief/test_vector_primitives.py",
    fails="cells of few readings: the covariance is taken for known exactly",
    survivor="student_t_vector",
)
def normal_vector(reading: Float64Array, cells: VectorCells) -> Float64Array:
    """Return log N(reading; mean, cov) per class, shape (..., m), for readings of shape (..., f)."""
    squared, log_det = _distance(reading, cells.mean, cells.cov)
    return np.asarray(-0.5 * (squared + log_det + cells.mean.shape[-1] * np.log(2.0 * np.pi)))


@method(
    task="likelihood_vector",
    name="student_t_vector",
    cost_s=3e-5,
    evidence="tests/palpation/perception/belief/test_vector_primitives.py",
    fails="readings of one trial that share an error: it widens for the training's size only",
)
def student_t_vector(reading: Float64Array, cells: VectorCells) -> Float64Array:
    """Return the log predictive density when mean and covariance were themselves estimated.

    Normal-inverse-Wishart with f prior pseudo-readings of covariance diag(floor^2) (Murphy, "Conjugate
    Bayesian analysis of the Gaussian distribution", 2007, sec. 9): Student-t with n degrees of freedom and
    scale ((n - 1) cov + f diag(floor^2)) (n + 1) / n^2. With one feature it is
    :func:`~palp_core.palpation.perception.belief.likelihoods.student_t`.
    """
    count, size = cells.count, cells.mean.shape[-1]
    scatter = (count - 1.0)[:, None, None] * cells.cov + size * np.diag(cells.floor**2)
    scale = scatter * ((count + 1.0) / count**2)[:, None, None]
    squared, log_det = _distance(reading, cells.mean, scale)
    constant = gammaln(0.5 * (count + size)) - gammaln(0.5 * count) - 0.5 * size * np.log(count * np.pi)
    return np.asarray(constant - 0.5 * log_det - 0.5 * (count + size) * np.log1p(squared / count))


@dataclass(frozen=True, eq=False)
class VectorPrimitives:
    """A multivariate normal per class and setting.

    Attributes:
        mean: Mean reading, shape (m, k, f).
        cov: Covariance, positive definite, shape (m, k, f, f).
        count: Training readings, shape (m, k).
        floor: Least standard deviation of each feature, shape (f,).
    """

    mean: Float64Array
    cov: Float64Array
    count: Float64Array
    floor: Float64Array

    def log_likelihood(
        self, reading: Float64Array, setting_index: int, *, model: str = "normal_vector"
    ) -> Float64Array:
        """Return log P(reading | class, setting), shape (..., m).

        Args:
            reading: Shape (..., f).
            setting_index: Which setting it was taken at.
            model: A method of task ``likelihood_vector``.

        Raises:
            PerceptionError: The reading is not finite or of another size, or the setting was not trained.
            MethodError: No such model.
        """
        seen = np.asarray(reading, dtype=np.float64)
        if seen.shape[-1:] != self.mean.shape[-1:] or not np.isfinite(seen).all():
            raise PerceptionError(
                f"a reading of shape {seen.shape} must be finite and have {self.mean.shape[-1]} features"
            )
        if not 0 <= setting_index < self.mean.shape[1]:
            raise PerceptionError(f"setting {setting_index} was not trained; there are {self.mean.shape[1]}")
        k = setting_index
        cells = VectorCells(self.mean[:, k], self.cov[:, k], self.count[:, k], self.floor)
        density: Float64Array = find("likelihood_vector", model).target(seen, cells)
        return density


def fit_vectors(
    readings: Float64Array,
    class_index: Sequence[int],
    setting_index: Sequence[int],
    *,
    class_count: int,
    setting_count: int,
    floor: Sequence[float],
) -> VectorPrimitives:
    """Fit mean and unbiased covariance of every cell; floor^2 is added to each variance.

    The floor is added, not a lower limit, so that equal readings, one reading, or features that depend on
    each other still have a positive definite covariance. A cell of one reading takes the pooled covariance.

    Args:
        readings: Training readings, shape (n, f).
        class_index: Class of each reading, length n.
        setting_index: Setting of each reading, length n.
        class_count: Number of classes m.
        setting_count: Number of settings k.
        floor: Least standard deviation of each feature, positive, length f.

    Raises:
        PerceptionError: Lengths differ, a value is not finite, an index is out of range, a floor is not
            positive, or a cell is empty.
    """
    values, least = np.asarray(readings, dtype=np.float64), np.asarray(floor, dtype=np.float64)
    classes, settings = np.asarray(class_index, dtype=np.int64), np.asarray(setting_index, dtype=np.int64)
    if (
        values.ndim != 2
        or not len(values) == len(classes) == len(settings)
        or least.shape != values.shape[1:]
    ):
        raise PerceptionError(
            "training: readings (n, f), class_index, setting_index (n) and floor (f) differ"
        )
    if not np.isfinite(values).all() or not (least > 0.0).all():
        raise PerceptionError("training: a reading is not finite, or a floor is not positive")
    shape = (class_count, setting_count)
    if len(values) and not (
        0 <= classes.min() <= classes.max() < class_count
        and 0 <= settings.min() <= settings.max() < setting_count
    ):
        raise PerceptionError(f"training: an index lies outside {shape} (classes, settings)")
    cell, size = classes * setting_count + settings, values.shape[1]
    count = np.bincount(cell, minlength=class_count * setting_count).astype(np.float64)
    if (count == 0).any():
        missing = [divmod(int(c), setting_count) for c in np.flatnonzero(count == 0)]
        raise PerceptionError(f"training: no reading for (class, setting) {missing}; palpate there")
    mean = np.zeros((count.size, size))
    np.add.at(mean, cell, values)
    mean /= count[:, None]
    away = values - mean[cell]
    scatter = np.zeros((count.size, size, size))
    np.add.at(scatter, cell, away[:, :, None] * away[:, None, :])
    pooled = scatter.sum(axis=0) / max(float((count - 1.0).sum()), 1.0)
    cov = np.where(
        (count > 1)[:, None, None], scatter / np.maximum(count - 1.0, 1.0)[:, None, None], pooled
    ) + np.diag(least**2)
    return VectorPrimitives(
        mean.reshape(*shape, size), cov.reshape(*shape, size, size), count.reshape(shape), least
    )
