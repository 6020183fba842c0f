import numpy as np
import pytest

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.markov import (
    check_stochastic,
    eigenvalues,
    kemeny_constant,
    relaxation_time,
    stationary,
    structure,
)

SPECTRA = np.array(figure5.EIGENVALUES)
KINDS: list[figure5.Reconstruction] = ["ar1", "tridiagonal"]
LAG_CORRELATIONS = (0.60, 0.67, 0.71)
"""Lag-1 correlation per depth of the Gaussian AR(1) with the closest spectrum (assumed form)."""
LEAST = 1e-6
"""Entries are at least so large in the default, which keeps the logarithm finite."""


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("depth", range(3))
def test_every_matrix_has_the_published_spectrum(kind: figure5.Reconstruction, depth: int) -> None:
    matrix = check_stochastic(figure5.matrices(kind)[depth])
    assert eigenvalues(matrix) == pytest.approx(SPECTRA[depth], abs=1e-10)
    found = structure(matrix)
    assert (found.closed_class_count, found.period) == (1, 1)
    assert matrix == pytest.approx(matrix[::-1, ::-1], abs=1e-12)  # both ends of the scale alike
    assert stationary(matrix) @ figure5.LEVELS == pytest.approx(figure5.MEAN_LEVEL)


@pytest.mark.parametrize("depth", range(3))
def test_the_default_is_the_nearest_to_the_kernel_in_relative_entropy(depth: int) -> None:
    """No step that keeps spectrum, columns and symmetry lowers it to first order."""
    levels, rho = np.array(figure5.LEVELS), LAG_CORRELATIONS[depth]
    centres = figure5.MEAN_LEVEL + rho * (levels - figure5.MEAN_LEVEL)
    kernel = np.exp(-0.5 * (levels[:, None] - centres) ** 2 / (figure5.SD_LEVEL**2 * (1.0 - rho**2)))
    kernel /= kernel.sum(axis=0)
    matrix = figure5.matrices()[depth]
    slope = stationary(kernel) * np.log(matrix / kernel)
    fixed = [k * np.linalg.matrix_power(matrix, k - 1).T for k in range(1, 5)]  # of the traces
    fixed += [np.tile(np.eye(5)[column], (5, 1)) for column in range(5)]

    def free(change: np.ndarray) -> np.ndarray:
        """Return what a change does to entries that are not at their least, both ends of the scale alike."""
        return np.asarray((change + change[::-1, ::-1])[matrix > 2.0 * LEAST])

    constraints = np.array([free(one) for one in fixed]).T
    shares = np.linalg.lstsq(constraints, free(slope))[0]
    assert constraints @ shares == pytest.approx(free(slope), abs=2e-4)
    pressed = slope - sum(share * one for share, one in zip(shares, fixed, strict=True))
    assert np.all((pressed + pressed[::-1, ::-1])[matrix <= 2.0 * LEAST] > 0.0)  # they would rather be less


@pytest.mark.parametrize("depth", range(3))
def test_the_mass_of_the_default_lies_near_the_diagonal_and_the_control_has_no_other(depth: int) -> None:
    near = np.abs(np.subtract.outer(np.arange(5), np.arange(5))) <= 1
    assert figure5.matrices()[depth].min() > 0.0
    assert np.where(near, figure5.matrices()[depth], 0.0).sum(axis=0).min() > 0.85
    assert not figure5.matrices("tridiagonal")[depth][~near].any()


def test_trace_relaxation_and_kemeny_follow_from_the_spectrum_alone() -> None:
    times = [relaxation_time(m) for m in figure5.matrices()]
    assert times == pytest.approx([1.0 / (1.0 - s[-2]) for s in figure5.EIGENVALUES])
    for first, second in zip(figure5.matrices("ar1"), figure5.matrices("tridiagonal"), strict=True):
        assert np.trace(first) == pytest.approx(np.trace(second), abs=1e-9)
        assert kemeny_constant(first) == pytest.approx(kemeny_constant(second), abs=1e-9)


def test_a_reconstruction_that_is_none_is_refused() -> None:
    with pytest.raises(PerceptionError, match="tridiagonal"):
        figure5.matrices("nope")  # type: ignore[arg-type]
