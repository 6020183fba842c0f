"""Two ways to a transition matrix with a given spectrum, by which the chains of Figure 5 were found.

Eigenvalues fix the trace, the relaxation time and Kemeny's constant, but not the matrix: the chain nearest to
a given kernel, and the only nearest-neighbour chain that treats both ends of the scale alike.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import LinearConstraint, NonlinearConstraint, minimize

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array

_LEAST_ENTRY = 1e-6  # keeps every entry positive and the logarithm finite


def ar1_kernel(levels: Float64Array, lag_correlation: float, *, mean: float, sd: float) -> Float64Array:
    """Return a stationary Gaussian AR(1) restricted to levels.

    Column i is N(mean + rho (x_i - mean), sd^2 (1 - rho^2)) at the levels, normalised.

    Args:
        levels: Values of the levels, shape (n,).
        lag_correlation: rho, between 0 and 1.
        mean: Stationary mean.
        sd: Stationary standard deviation.

    Returns:
        Column-stochastic M[next, current], shape (n, n).
    """
    centres = mean + lag_correlation * (levels - mean)
    variance = sd * sd * (1.0 - lag_correlation**2)
    density = np.exp(-0.5 * (levels[:, None] - centres[None, :]) ** 2 / variance)
    return np.asarray(density / density.sum(axis=0))


def nearest_chain(
    kernel: Float64Array, spectrum: Float64Array, *, by_squares_from: Float64Array | None = None
) -> Float64Array:
    """Return the chain with ``spectrum`` that differs least from ``kernel`` and keeps its symmetry.

    Least is the relative entropy per step, sum_i p_i KL(M[:, i] | K[:, i]), p the kernel's stationary law,
    found from the kernel as start (sequential quadratic programming). The spectrum is imposed through the
    traces of M, M^2, ...

    Args:
        kernel: Positive column-stochastic matrix, unchanged when the scale is turned round, shape (n, n).
        spectrum: Real eigenvalues with a 1 among them, shape (n,).
        by_squares_from: Least is the sum of squared differences of the entries instead, sought from here.

    Raises:
        PerceptionError: The kernel is not symmetric under reversal of the scale, or no such chain was found.
    """
    size = len(kernel)
    if np.abs(kernel - kernel[::-1, ::-1]).max() > 1e-9:
        raise PerceptionError("the kernel must be unchanged when the order of the levels is turned round")
    powers = np.arange(1, size)
    traces = np.array([(spectrum**k).sum() for k in powers])
    expand = _reversal_symmetric_basis(size)
    column_sums: Float64Array = (np.kron(np.ones((1, size)), np.eye(size)) @ expand)[: (size + 1) // 2]
    weight = np.tile(_leading_vector(kernel), size)
    flat = kernel.ravel()

    def entropy(free: Float64Array) -> float:
        entries = expand @ free
        return float(weight @ (entries * np.log(entries / flat) - entries + flat))

    def entropy_slope(free: Float64Array) -> Float64Array:
        return np.asarray(expand.T @ (weight * np.log(expand @ free / flat)))

    def squares(free: Float64Array) -> float:
        return float(((expand @ free - flat) ** 2).sum())

    def squares_slope(free: Float64Array) -> Float64Array:
        return np.asarray(2.0 * expand.T @ (expand @ free - flat))

    def trace_error(free: Float64Array) -> Float64Array:
        matrix = (expand @ free).reshape(size, size)
        return np.asarray([np.trace(np.linalg.matrix_power(matrix, int(k))) for k in powers] - traces)

    def trace_slope(free: Float64Array) -> Float64Array:
        matrix = (expand @ free).reshape(size, size)
        rows = [k * np.linalg.matrix_power(matrix, int(k) - 1).T.ravel() for k in powers]
        return np.asarray(np.array(rows) @ expand)

    start = np.linalg.lstsq(expand, flat if by_squares_from is None else by_squares_from.ravel())[0]
    found = minimize(
        entropy if by_squares_from is None else squares,
        np.maximum(start, _LEAST_ENTRY),
        jac=entropy_slope if by_squares_from is None else squares_slope,
        bounds=[(_LEAST_ENTRY, 1.0)] * start.size,
        constraints=[
            NonlinearConstraint(trace_error, 0.0, 0.0, jac=trace_slope),
            LinearConstraint(column_sums, 1.0, 1.0),
        ],
        method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 500},
    )
    matrix = (expand @ found.x).reshape(size, size)
    reached = np.sort(np.linalg.eigvals(matrix).real)
    if np.abs(reached - np.sort(spectrum)).max() > 1e-7:
        raise PerceptionError(f"no chain near the kernel has the spectrum {spectrum}; reached {reached}")
    return np.asarray(matrix / matrix.sum(axis=0))


def tridiagonal_chain(spectrum: Float64Array) -> Float64Array:
    """Return the nearest-neighbour chain with ``spectrum`` that is unchanged when the scale is turned round.

    It is unique: a persymmetric Jacobi matrix is determined by its eigenvalues (Hochstadt, 1967). Its
    eigenvectors' first components squared are proportional to 1 / |chi'(lambda)|, from which Lanczos'
    recursion gives the entries (de Boor and Golub, 1978); scaling by the leading eigenvector makes the
    columns sum to 1.

    Args:
        spectrum: Distinct real eigenvalues, the largest 1, shape (n,).

    Raises:
        PerceptionError: Eigenvalues coincide, the largest is not 1, or the chain would have a negative entry.
    """
    values = np.sort(np.asarray(spectrum, dtype=np.float64))
    gaps = values[:, None] - values[None, :] + np.eye(values.size)
    if np.abs(gaps).min() < 1e-9 or abs(values[-1] - 1.0) > 1e-9:
        raise PerceptionError(f"the spectrum {values} must be of distinct values, the largest of them 1")
    vector = 1.0 / np.sqrt(np.abs(gaps.prod(axis=1)))
    vector /= np.linalg.norm(vector)
    previous, beside = np.zeros_like(vector), 0.0
    diagonal, off_diagonal = [], []
    for _ in values:
        image = values * vector
        diagonal.append(float(vector @ image))
        rest = image - diagonal[-1] * vector - beside * previous
        beside = float(np.linalg.norm(rest))
        off_diagonal.append(beside)
        previous, vector = vector, rest / beside
    jacobi = np.diag(diagonal) + np.diag(off_diagonal[:-1], 1) + np.diag(off_diagonal[:-1], -1)
    scale = np.sqrt(_leading_vector(jacobi, squared=True))
    matrix = scale[:, None] * jacobi / scale[None, :]
    if matrix.min() < 0.0:
        raise PerceptionError(
            f"the nearest-neighbour chain of {values} would have a negative entry {matrix.min():.3g}"
        )
    return np.asarray(matrix / matrix.sum(axis=0))


def _leading_vector(matrix: Float64Array, *, squared: bool = False) -> Float64Array:
    """Return the leading eigenvector, positive, its entries (or their squares) summing to 1."""
    values, vectors = np.linalg.eig(matrix)
    leading = np.abs(vectors[:, np.argmax(values.real)].real)
    weights = leading**2 if squared else leading
    return np.asarray(weights / weights.sum())


def _reversal_symmetric_basis(size: int) -> Float64Array:
    """Return the 0/1 matrix that expands free entries to a flat matrix with M[i, j] = M[n-1-i, n-1-j]."""
    flat = np.arange(size * size)
    representative = np.minimum(flat, size * size - 1 - flat)
    basis = np.zeros((flat.size, (flat.size + 1) // 2))
    basis[flat, representative] = 1.0
    return basis
