import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from palp_core.errors import PerceptionError
from palp_core.palpation.methods import find, methods
from palp_core.palpation.perception.belief.likelihoods import Cells, student_t
from palp_core.palpation.perception.belief.vector_primitives import VectorCells, fit_vectors, student_t_vector

seeds = st.integers(0, 10_000)


def trained(
    seed: int, m: int = 3, k: int = 2, f: int = 2, each: int = 10
) -> tuple[np.ndarray, list[int], list[int]]:
    rng = np.random.default_rng(seed)
    classes, places = np.repeat(np.arange(m), k * each), np.tile(np.repeat(np.arange(k), each), m)
    return rng.normal(classes[:, None], 1.0, (m * k * each, f)), classes.tolist(), places.tolist()


@given(seeds, st.integers(1, 4), st.integers(1, 6), st.integers(1, 5))
@settings(max_examples=20, deadline=None)
def test_it_serves_any_number_of_classes_settings_and_features(seed: int, f: int, m: int, k: int) -> None:
    readings, classes, places = trained(seed, m, k, f)
    learnt = fit_vectors(readings, classes, places, class_count=m, setting_count=k, floor=[0.01] * f)
    for one in methods("likelihood_vector"):
        assert np.isfinite(learnt.log_likelihood(readings[0], k - 1, model=one.name)).all()


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_the_normal_is_scipys(seed: int) -> None:
    readings, classes, places = trained(seed)
    learnt = fit_vectors(readings, classes, places, class_count=3, setting_count=2, floor=[0.01, 0.02])
    new = readings[:5] + 0.3
    expected = [stats.multivariate_normal(learnt.mean[d, 1], learnt.cov[d, 1]).logpdf(new) for d in range(3)]
    assert learnt.log_likelihood(new, 1) == pytest.approx(np.transpose(expected))


@given(seeds, st.integers(1, 20))
@settings(max_examples=20, deadline=None)
def test_with_one_feature_the_predictive_is_the_scalar_one(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    mean, sd, n = rng.normal(size=3), rng.uniform(0.2, 2.0, 3), np.full(3, float(count))
    scalar = student_t(0.7, Cells(mean, sd, n, 0.1))
    vector = student_t_vector(
        np.array([0.7]), VectorCells(mean[:, None], (sd**2)[:, None, None], n, np.array([0.1]))
    )
    assert vector == pytest.approx(scalar)


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_the_predictive_tends_to_the_normal_as_training_grows(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = VectorCells(
        rng.normal(size=(3, 2)), np.tile(np.eye(2), (3, 1, 1)), np.full(3, 1e7), np.full(2, 0.1)
    )
    new = rng.normal(size=2)
    normal, wide = (
        find("likelihood_vector", n).target(new, cells) for n in ("normal_vector", "student_t_vector")
    )
    assert wide == pytest.approx(normal, abs=1e-4)


@pytest.mark.parametrize("each", [1, 3])
def test_equal_or_single_readings_still_have_a_density(each: int) -> None:
    readings, classes, places = trained(0, each=each)
    flat = np.zeros_like(readings)
    learnt = fit_vectors(flat, classes, places, class_count=3, setting_count=2, floor=[0.01, 0.01])
    for one in methods("likelihood_vector"):
        assert np.isfinite(learnt.log_likelihood(np.array([5.0, -5.0]), 0, model=one.name)).all()


def test_features_that_depend_on_each_other_still_have_a_density() -> None:
    readings, classes, places = trained(0)
    readings[:, 1] = 2.0 * readings[:, 0]
    learnt = fit_vectors(readings, classes, places, class_count=3, setting_count=2, floor=[0.01, 0.01])
    assert np.isfinite(learnt.log_likelihood(np.array([1.0, -5.0]), 0)).all()


def test_bad_training_is_refused_with_what_to_do() -> None:
    readings, classes, places = trained(0)
    options = {"class_count": 3, "setting_count": 2}
    with pytest.raises(PerceptionError, match=r"\(class, setting\) \[\(3, 0\), \(3, 1\)\]"):
        fit_vectors(readings, classes, places, class_count=4, setting_count=2, floor=[0.1, 0.1])
    with pytest.raises(PerceptionError, match="floor is not positive"):
        fit_vectors(readings, classes, places, floor=[0.1, 0.0], **options)
    with pytest.raises(PerceptionError, match="outside"):
        fit_vectors(readings, classes, [p + 1 for p in places], floor=[0.1, 0.1], **options)
    learnt = fit_vectors(readings, classes, places, floor=[0.1, 0.1], **options)
    with pytest.raises(PerceptionError, match="2 features"):
        learnt.log_likelihood(np.zeros(3), 0)
    with pytest.raises(PerceptionError, match="not trained"):
        learnt.log_likelihood(np.zeros(2), 2)
