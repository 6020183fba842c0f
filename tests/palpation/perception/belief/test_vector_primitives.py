"""Readings of several columns: the densities are the scalar ones, and scipy's where they are correlated."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from palp_core.errors import MethodError, PerceptionError
from palp_core.palpation.perception.belief import primitives
from palp_core.palpation.perception.belief.vector_primitives import (
    VectorPrimitives,
    column_floor,
    fit_vectors,
)

Array = NDArray[np.float64]
COUNT = 9


def taught(columns: int, *, full: bool, seed: int = 0) -> tuple[VectorPrimitives, Array]:
    """Return primitives of two classes at two settings, and the readings by cell, shape (2, 2, n, f)."""
    rng = np.random.default_rng(seed)
    mixing = rng.normal(size=(columns, columns))
    cells = 3.0 * rng.normal(size=(2, 2, 1, columns)) + rng.normal(size=(2, 2, COUNT, columns)) @ mixing
    label, setting = (i.ravel() for i in np.indices((2, 2, COUNT))[:2])
    found = fit_vectors(
        cells.reshape(-1, columns),
        label,
        setting,
        shape=(2, 2),
        floor=np.full(columns, 1e-3),
        full=full,
    )
    return found, cells


@pytest.mark.parametrize("model", ["normal", "student_t", "robust"])
@pytest.mark.parametrize("full", [False, True])
def test_one_column_is_the_scalar_primitives(model: str, full: bool) -> None:
    found, cells = taught(1, full=full)
    label, setting = (i.ravel().tolist() for i in np.indices((2, 2, COUNT))[:2])
    scalar = primitives.fit(
        cells.ravel(), label, setting, depths_m=[1.0, 2.0], rings_m=[1.0, 2.0], floor=1e-3
    )
    for reading in (-2.0, 0.3, 40.0):
        for k in (0, 1):
            assert found.log_likelihood(np.array([reading]), k, model=model) == pytest.approx(
                scalar.log_likelihood(reading, k, model=model), rel=1e-12
            )


def test_independent_columns_add_up() -> None:
    found, cells = taught(3, full=False)
    reading = np.array([0.4, -1.0, 2.0])
    of = cells[:, 1]
    expected = stats.norm(of.mean(axis=1), of.std(axis=1, ddof=1)).logpdf(reading).sum(axis=-1)
    assert found.log_likelihood(reading, 1) == pytest.approx(expected)


def test_correlated_columns_are_scipy_s_normal() -> None:
    found, cells = taught(3, full=True)
    reading = np.array([0.4, -1.0, 2.0])
    expected = [
        stats.multivariate_normal(one.mean(axis=0), np.cov(one.T)).logpdf(reading) for one in cells[:, 0]
    ]
    assert found.log_likelihood(reading, 0) == pytest.approx(expected)


def test_estimated_covariances_give_scipy_s_student_t() -> None:
    """Of Gelman et al.: n - f + 1 degrees of freedom, the scatter over them times 1 + 1 / n."""
    found, cells = taught(3, full=True)
    reading = np.array([0.4, -1.0, 2.0])
    freedom = COUNT - 3 + 1
    expected = [
        stats.multivariate_t(
            one.mean(axis=0),
            ((COUNT - 1) * np.cov(one.T) + 1e-6 * np.eye(3)) * (1 + 1 / COUNT) / freedom,
            df=freedom,
        ).logpdf(reading)
        for one in cells[:, 0]
    ]
    assert found.log_likelihood(reading, 0, model="student_t") == pytest.approx(expected)


def test_many_readings_at_once_are_each_by_itself() -> None:
    found, _ = taught(2, full=True)
    some = np.random.default_rng(1).normal(size=(4, 2))
    together = found.log_likelihood(some, 0)
    assert together.shape == (4, 2)
    assert together == pytest.approx(np.array([found.log_likelihood(one, 0) for one in some]))


def test_the_floor_is_the_step_of_the_numbers() -> None:
    """A column in steps of 0.1, told from what rounding leaves between 0.1 + 0.2 and 0.3."""
    column = np.array([0.1 + 0.2, 0.3, 0.4, 0.9])
    assert column_floor(column[:, None]) == pytest.approx([0.1 / np.sqrt(12.0)])
    with pytest.raises(PerceptionError, match="column 1 are 5; it tells nothing"):
        column_floor(np.array([[1.0, 5.0], [2.0, 5.0]]))


def test_equal_readings_of_a_cell_have_the_floor_s_spread() -> None:
    zero = np.zeros(4, dtype=np.int64)
    found = fit_vectors(np.ones((4, 1)), zero, zero, shape=(1, 1), floor=np.array([0.5]), full=False)
    assert found.cov.ravel() == pytest.approx([0.25])


def test_what_cannot_be_told_is_said() -> None:
    found, cells = taught(2, full=True)
    with pytest.raises(PerceptionError, match="drop it"):
        found.log_likelihood(np.array([1.0, np.nan]), 0)
    with pytest.raises(PerceptionError, match="'robust' knows single columns"):
        found.log_likelihood(np.ones(2), 0, model="robust")
    with pytest.raises(MethodError):
        found.log_likelihood(np.ones(2), 0, model="guess")
    label, setting = (i.ravel() for i in np.indices((2, 2, COUNT))[:2])
    twice = np.repeat(cells.reshape(-1, 2)[:, :1], 2, axis=1)
    with pytest.raises(PerceptionError, match="a function of the others"):
        fit_vectors(twice, label, setting, shape=(2, 2), floor=np.full(2, 1e-3), full=True)
    bare = fit_vectors(
        cells.reshape(-1, 2), label, 0 * setting, shape=(2, 2), floor=np.full(2, 1e-3), full=False
    )
    with pytest.raises(PerceptionError, match="setting 1 was not felt with every class"):
        bare.log_likelihood(np.ones(2), 1)
