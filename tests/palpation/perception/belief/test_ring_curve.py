import numpy as np
import pytest

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief.ring_curve import ring_curve

RINGS_M = np.array([0.0, 0.004, 0.008, 0.012, 0.016])
TRUE = 5e-4 + np.array([[1.70], [1.67], [1.64]]) * RINGS_M - np.array([[5.0], [5.5], [6.0]]) * RINGS_M**2
ERROR = np.full(TRUE.shape, 2.5e-4)


def test_the_stated_uncertainty_is_the_one_it_has() -> None:
    rng = np.random.default_rng(1)
    away, stated = [], []
    for _ in range(400):
        found = ring_curve(TRUE + ERROR * rng.standard_normal(TRUE.shape), ERROR, RINGS_M)
        away.append(found.mean - TRUE)
        stated.append((found.root**2).sum(axis=-1) / max(found.misfit, 1.0))
    assert np.var(away, axis=0) == pytest.approx(np.mean(stated, axis=0), rel=0.25)


def test_depths_look_no_further_apart_than_they_are_where_they_hardly_differ() -> None:
    rng = np.random.default_rng(2)
    cells = TRUE + ERROR * rng.standard_normal((300, *TRUE.shape))
    curves = np.array([ring_curve(one, ERROR, RINGS_M).mean for one in cells])
    true, seen, fitted = (np.abs(x[..., 0, 1] - x[..., 2, 1]).mean() for x in (TRUE, cells, curves))
    assert true < fitted < 0.85 * seen
    assert seen > 1.3 * true


def test_cells_that_are_known_better_than_a_parabola_contradict_it() -> None:
    bent = TRUE + 2e-4 * np.sin(RINGS_M / 0.002)
    assert not ring_curve(bent, ERROR / 10.0, RINGS_M).fits
    assert ring_curve(bent, ERROR, RINGS_M).fits


def test_three_positions_do_not_show_whether_a_parabola_fits() -> None:
    with pytest.raises(PerceptionError, match="four positions"):
        ring_curve(TRUE[:, :3], ERROR[:, :3], RINGS_M[:3])
