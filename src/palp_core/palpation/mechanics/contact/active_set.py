"""Frictionless contact on a condensed compliance: which points touch, and with what force."""

import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.errors import MechanicsError
from palp_core.units import Float64Array

_PATIENCE = 8  # block exchanges without progress before single exchanges take over
_ROUNDS = 2000


def solve_contact(
    compliance: Float64Array, gap: Float64Array, start: NDArray[np.bool_] | None = None
) -> Float64Array:
    """Return the forces p >= 0 with C p >= g where p = 0 and C p = g elsewhere.

    Block principal pivoting: all points that break a condition change sides at once; when that stops making
    progress, only the last of them does, which ends for every positive definite matrix (Judice and Pires,
    Computers and Operations Research 21 (1994) 587).
    """
    if not np.any(gap > 0.0):
        return np.zeros(gap.shape)
    touching = gap > 0.0 if start is None else start.copy()
    fewest, patience = gap.size + 1, _PATIENCE
    scale = 1e-12 * float(gap.max())
    for _ in range(_ROUNDS):
        force = np.zeros(gap.shape)
        at = np.flatnonzero(touching)
        if at.size:
            try:
                force[at] = scipy.linalg.cho_solve(
                    scipy.linalg.cho_factor(compliance[np.ix_(at, at)], lower=True, check_finite=False),
                    gap[at],
                )
            except np.linalg.LinAlgError as error:
                raise MechanicsError(
                    "the compliance of the surface is not positive definite: the cells are too coarse for "
                    "the gel over the bead; use smaller cells"
                ) from error
        wrong = np.where(touching, force < 0.0, compliance @ force - gap < -scale)
        count = int(np.count_nonzero(wrong))
        if count == 0:
            return force
        if count < fewest:
            fewest, patience = count, _PATIENCE
        elif patience > 0:
            patience -= 1
        else:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        touching ^= wrong
    raise MechanicsError("the contact did not settle; the compliance of the surface is not positive definite")
