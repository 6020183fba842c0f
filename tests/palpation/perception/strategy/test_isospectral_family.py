import numpy as np
import pytest

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.isospectral_family import (
    ar1_kernel,
    figure5_family,
    near_kernel,
    sample_family,
)
from palp_core.palpation.perception.strategy.markov import (
    check_stochastic,
    eigenvalues,
    kemeny_constant,
    relaxation_time,
)

SPECTRA = np.array(figure5.EIGENVALUES)


@pytest.fixture(scope="module")
def family() -> np.ndarray:
    return figure5_family(np.random.default_rng(1), 12, step_count=150)


def test_every_member_is_a_chain_with_the_published_spectrum(family: np.ndarray) -> None:
    assert family.shape == (12, 3, 5, 5)
    for member in family:
        for matrix, spectrum in zip(member, SPECTRA, strict=True):
            assert eigenvalues(check_stochastic(matrix)) == pytest.approx(spectrum, abs=1e-6)


def test_members_share_what_the_spectrum_fixes_and_differ_in_the_rest(family: np.ndarray) -> None:
    for depth in range(3):
        these = family[:, depth]
        assert np.ptp([relaxation_time(m) for m in these]) < 1e-5
        assert np.ptp([kemeny_constant(m) for m in these]) < 1e-4
        assert np.ptp(these[:, 2, 2]) > 0.02
        assert np.abs(these[0] - these[1]).max() > 0.02


def test_the_same_seed_gives_the_same_family() -> None:
    first, again = (figure5_family(np.random.default_rng(3), 2, step_count=20) for _ in range(2))
    assert np.array_equal(first, again)


def test_of_two_states_the_walk_finds_the_prior_restricted_to_the_spectrum() -> None:
    """Of trace 1.3 is [[x, x - 0.3], ..]: one free number, whose law is a product of two beta densities."""
    start = np.array([[0.7, 0.4], [0.3, 0.6]])
    prior = np.array([[3.0, 1.5], [2.0, 4.0]])
    drawn = sample_family(start, prior, np.random.default_rng(2), 600, step_count=60, step_size=0.3)
    x = np.linspace(0.3, 1.0, 20_001)[1:-1]
    other = 1.3 - x
    density = x**2.0 * (1.0 - x) ** 1.0 * (1.0 - other) ** 0.5 * other**3.0
    mean = (density @ x) / density.sum()
    sd = np.sqrt((density @ (x - mean) ** 2) / density.sum())
    found = drawn[:, 0, 0]
    assert found.mean() == pytest.approx(mean, abs=4.0 * sd / np.sqrt(600))
    assert found.std() == pytest.approx(sd, rel=0.12)


def test_a_stronger_prior_stays_nearer_to_the_kernel() -> None:
    kernel = ar1_kernel(np.array(figure5.LEVELS), 0.67, mean=0.3, sd=0.08)
    far, near = (
        sample_family(
            figure5.matrices()[1], near_kernel(kernel, weight), np.random.default_rng(4), 20, step_count=150
        )
        for weight in (2.0, 200.0)
    )
    assert np.abs(near - kernel).mean() < np.abs(far - kernel).mean()


@pytest.mark.parametrize(
    ("start", "prior"),
    [
        (np.eye(2), np.ones((2, 2))),
        (np.full((2, 2), 0.5), np.full((2, 2), 0.5)),
        (np.full((2, 2), 0.5), np.ones((3, 3))),
    ],
)
def test_what_has_no_family_is_refused(start: np.ndarray, prior: np.ndarray) -> None:
    with pytest.raises(PerceptionError, match="family"):
        sample_family(start, prior, np.random.default_rng(0), 1)
    with pytest.raises(PerceptionError, match="weight"):
        near_kernel(np.eye(2), -1.0)
