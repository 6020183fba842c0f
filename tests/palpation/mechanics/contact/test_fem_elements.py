"""Where finite-element methods fail, and that what the rungs use instead survives the same range."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from palp_core.errors import OutOfRange
from palp_core.palpation.mechanics.contact import fem_failures
from palp_core.palpation.mechanics.contact.fem_failures import (
    coarse_cells,
    critical_step_s,
    finite_strain_error,
    iterations_of_conjugate_gradients,
    residual_of_direct_solution,
    small_strain_excess,
    softness_error_of_linear_triangles,
    softness_error_of_taylor_hood,
    truncation_error,
)


def explicit_growth(poisson: float, share: float, steps: int = 400, parts: int = 4) -> float:
    """Return how far a suddenly loaded slab moves in central differences, over twice its static sinking.

    Args:
        poisson: Poisson's ratio.
        share: Step over the critical one: up to 1 the motion is at most about that, beyond it grows for ever.
        steps: How many.
        parts: Cells under the load.
    """
    matrix, load = fem_failures._rates(poisson, parts)
    load = load * fem_failures._MODULUS_PA
    step_s = share * critical_step_s(poisson, parts)
    still = splu(matrix.tocsc()).solve(load)
    before, now, largest = np.zeros(load.size), np.zeros(load.size), 0.0
    for _ in range(steps):
        before, now = now, 2.0 * now - before + step_s**2 * (load - matrix @ now)
        largest = max(largest, float(np.linalg.norm(now)))
    return largest / (2.0 * float(np.linalg.norm(still)))


@pytest.mark.slow
def test_linear_triangles_lock_from_nu_049_on_and_taylor_hood_does_not() -> None:
    ratios = [0.3, 0.45, 0.49, 0.499, 0.4999, 0.49999]
    locked = [softness_error_of_linear_triangles(nu) for nu in ratios]
    assert abs(locked[1]) < 0.06
    assert locked[2] < -0.1
    assert locked[4] < -0.8  # several hundred per cent too stiff
    assert locked == sorted(locked, reverse=True)
    assert all(abs(softness_error_of_taylor_hood(nu)) < 0.002 for nu in ratios)


@pytest.mark.slow
def test_elements_converge_at_their_orders() -> None:
    linear = [abs(softness_error_of_linear_triangles(0.3, parts)) for parts in (4, 8, 16)]
    hood = [abs(softness_error_of_taylor_hood(0.49, parts)) for parts in (2, 4, 8)]
    assert np.all(-np.diff(np.log2(linear)) > 1.5)
    assert np.all(-np.diff(np.log2(hood)) > 1.9)  # the pressure's edge is singular


def test_conjugate_gradients_give_up_near_incompressibility() -> None:
    counts = [iterations_of_conjugate_gradients(nu) for nu in (0.3, 0.45, 0.49)]
    known = [count for count in counts if count is not None]
    assert len(known) == 3
    assert known == sorted(known)
    assert known[2] > 2 * known[0]
    assert iterations_of_conjugate_gradients(0.4999) is None
    assert all(residual_of_direct_solution(nu) < 1e-8 for nu in (0.3, 0.49, 0.4999))


@pytest.mark.slow
@pytest.mark.parametrize("poisson", [0.3, 0.49])
def test_explicit_elements_blow_up_past_a_step_of_microseconds_and_not_before(poisson: float) -> None:
    assert explicit_growth(poisson, 0.98) < 2.0
    assert explicit_growth(poisson, 1.02) > 1e6
    assert 1e-6 < critical_step_s(poisson) < 1e-4


@pytest.mark.slow
def test_cells_larger_than_the_gel_over_the_bead_spoil_the_compliance_unless_averaged() -> None:
    assert coarse_cells(1.5)[1] > 0.05
    smallest, error = coarse_cells(1.5, averaged=True)
    assert smallest > 0.0
    assert abs(error) < 0.03


@pytest.mark.slow
def test_fine_cells_keep_the_compliance_and_the_coarsest_make_it_negative() -> None:
    fine = coarse_cells(0.5)
    assert fine[0] > 0.0
    assert abs(fine[1]) < 0.02
    assert coarse_cells(2.0)[0] < 0.0
    smallest, error = coarse_cells(2.0, averaged=True)
    assert smallest > 0.0
    assert abs(error) < 0.03


@pytest.mark.slow
def test_a_block_is_the_less_stiff_the_farther_it_ends_and_the_endless_layer_is_the_widest() -> None:
    errors = [truncation_error(outer_m) for outer_m in (0.04, 0.06, 0.08, 0.11, 0.15)]
    assert errors == sorted(errors)
    assert errors[0] < -0.02
    assert errors[2] < -1e-3
    assert abs(errors[3]) < 1e-3
    assert abs(softness_error_of_taylor_hood(0.49, 6, 0.3)) < 1e-3  # the endless layer is the widest block


@pytest.mark.slow
def test_small_strain_overstates_the_force_where_the_indentation_nears_the_balls_radius() -> None:
    pressed_m = np.array([0.0006, 0.0015, 0.003, 0.0045, 0.006])
    excess = small_strain_excess(pressed_m)
    assert np.all(np.diff(excess) > 0.0)
    assert excess[0] < 0.05
    assert excess[2] > 0.05
    assert excess[4] > 0.10
    assert np.abs(finite_strain_error(pressed_m)).max() < 0.02
    with pytest.raises(OutOfRange, match="radius"):
        finite_strain_error(np.array([0.0061]))
