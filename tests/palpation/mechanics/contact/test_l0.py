"""Rung L0: a bump fitted to forces, and its laws."""

from __future__ import annotations

import numpy as np
import pytest

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom, Probe, sweep
from palp_core.palpation.mechanics.contact import Bump, FittedBump, fit_bump
from palp_core.palpation.mechanics.scene.output import contrast_n_m, peak_n_m

OFFSET_M, INDENTATION_M = np.meshgrid(
    np.linspace(-0.02, 0.02, 31), np.linspace(0.001, 0.004, 7), indexing="ij"
)
TRUE = Bump(stiffness=(2800.0, 1.2e5), rise=0.6, width_m=0.006, within_m=(0.001, 0.004), residual=0.0)


def bump(depth_m: float | None = 0.004) -> FittedBump:
    bead = None if depth_m is None else Bead(depth_m=depth_m)
    return FittedBump(Phantom(bead=bead), 0.006)


def test_a_fit_finds_the_bump_that_made_the_forces() -> None:
    model = FittedBump(Phantom(bead=Bead(depth_m=0.004)), 0.006, TRUE)
    found = fit_bump(OFFSET_M, INDENTATION_M, model.force(OFFSET_M, INDENTATION_M)[0])
    assert found.stiffness == pytest.approx(TRUE.stiffness, rel=1e-4)
    assert (found.rise, found.width_m) == pytest.approx((TRUE.rise, TRUE.width_m), rel=1e-5)
    assert found.residual < 1e-6


@pytest.mark.parametrize(("depth_m", "contrast_within"), [(0.004, 0.10), (0.008, 0.12)])
def test_at_its_working_point_it_replays_the_rung_it_was_fitted_to(
    depth_m: float, contrast_within: float
) -> None:
    stage_m = np.linspace(-0.03, 0.05, 161)
    truth = LayeredHertz(Phantom(bead=Bead(depth_m=depth_m)), 0.006)
    a, b = (sweep(model, Probe(), 0.016, 0.004, stage_m) for model in (bump(depth_m), truth))
    assert peak_n_m(a) == pytest.approx(peak_n_m(b), rel=0.01)
    assert contrast_n_m(a) == pytest.approx(contrast_n_m(b), rel=contrast_within)


@pytest.mark.parametrize("normal_n", [np.zeros(9), np.full(9, np.nan), np.ones(3)])
def test_forces_that_no_bump_fits_are_refused(normal_n: np.ndarray[tuple[int], np.dtype[np.float64]]) -> None:
    with pytest.raises(MechanicsError, match="six or more"):
        fit_bump(np.zeros(normal_n.shape), np.full(normal_n.shape, 0.002), normal_n)
