"""The expected gain of vector readings: the scalar one, and a Monte Carlo of scipy's densities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from palp_core.palpation.perception.belief.information import expected_gains_bits
from palp_core.palpation.perception.belief.vector_gain import ExpectedGain
from palp_core.palpation.perception.belief.vector_primitives import VectorPrimitives

CLASSES, SETTINGS = 3, 2


def known(columns: int, seed: int = 0) -> VectorPrimitives:
    rng = np.random.default_rng(seed)
    mean = 1.5 * rng.normal(size=(CLASSES, SETTINGS, columns))
    mixing = rng.normal(size=(CLASSES, SETTINGS, columns, columns))
    cov = mixing @ np.swapaxes(mixing, -1, -2) / columns + 0.4 * np.eye(columns)
    return VectorPrimitives(
        mean, cov, np.full((CLASSES, SETTINGS), 50.0), np.full(columns, 1e-3), columns > 1
    )


def test_one_column_is_the_scalar_gain() -> None:
    of = known(1)
    belief = np.array([0.5, 0.3, 0.2])
    expected = expected_gains_bits(belief, of.mean[..., 0].T, np.sqrt(of.cov[..., 0, 0]).T)
    assert ExpectedGain.of(of, (0, 1)).bits(belief) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("columns", [2, 4])
def test_several_columns_are_a_monte_carlo_of_scipy_s_densities(columns: int) -> None:
    of, rng = known(columns), np.random.default_rng(3)
    belief = np.array([0.6, 0.3, 0.1])
    found = ExpectedGain.of(of, (0, 1)).bits(belief)
    for k in range(SETTINGS):
        laws = [stats.multivariate_normal(of.mean[c, k], of.cov[c, k]) for c in range(CLASSES)]
        bits = 0.0
        for own, law in enumerate(laws):
            drawn = law.rvs(20_000, random_state=rng)
            densities = np.array([one.pdf(drawn) for one in laws])
            bits += belief[own] * float(np.log2(densities[own] / (belief @ densities)).mean())
        assert found[k] == pytest.approx(bits, abs=0.03)  # 0.02 of ours, 0.01 of theirs


def test_nothing_is_told_where_classes_feel_alike_or_one_is_certain() -> None:
    of = known(2)
    alike = VectorPrimitives(
        np.repeat(of.mean[:1], CLASSES, axis=0),
        np.repeat(of.cov[:1], CLASSES, axis=0),
        of.count,
        of.floor,
        True,
    )
    assert ExpectedGain.of(alike, (0, 1)).bits(np.full(3, 1 / 3)) == pytest.approx([0.0, 0.0], abs=1e-12)
    assert ExpectedGain.of(of, (1,)).bits(np.array([0.0, 1.0, 0.0])) == pytest.approx([0.0], abs=1e-12)
