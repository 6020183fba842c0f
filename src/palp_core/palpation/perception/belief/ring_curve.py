"""Primitives that know the law of the joint: readings are smooth in the ring's position, and none at zero.

By eq. (6) the joint's stiffness is proportional to r_a, so a reading is a smooth function of it, and at
r_a = 0 a slack joint passes on nothing of the depth. Where training landed few times in a cell, each cell's
mean is off by its own landing. Taken one by one, depths then look further apart at a ring than they are, most
of all where they hardly differ: E (a + e)^2 = a^2 + E e^2. A policy that looks for such positions trusts them
too much. A curve through all cells of training takes that back.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array

LEAST_RINGS = 4
"""Positions from which on it shows whether a parabola fits."""


@dataclass(frozen=True, eq=False)
class RingCurve:
    """Means along the curves, and how far off they may be."""

    mean: Float64Array  # Shape (m, k)
    # Their uncertainty: the error of class d is `root[d] @ z` with standard normal z, shape (m, k, 3)
    root: Float64Array
    # Weighted squared residual per degree of freedom; 1 where landings alone scatter the cells. Above 1 the
    # uncertainty has been widened by it (Birge, 1932).
    misfit: float
    freedom: int  # Degrees of freedom of it

    @property
    def fits(self) -> bool:
        """Whether the cells do not contradict the curve: chi squared at 0.1 %."""
        return self.misfit * self.freedom <= float(scipy.stats.chi2.ppf(0.999, self.freedom))


def ring_curve(mean: Float64Array, error_sd: Float64Array, rings_m: Float64Array) -> RingCurve:
    """Fit a parabola in r_a per class, all through one point at r_a = 0, by weighted least squares."""
    m, k = mean.shape
    if len(np.unique(rings_m)) < LEAST_RINGS or not (error_sd > 0.0).all():
        raise PerceptionError("a curve over the ring needs four positions and a positive error of every mean")
    x = rings_m / np.abs(rings_m).max()
    own = np.stack([x, x**2], axis=1)  # (k, 2)
    design = np.zeros((m, k, 1 + 2 * m))
    design[..., 0] = 1.0
    for d in range(m):
        design[d, :, 1 + 2 * d : 3 + 2 * d] = own
    flat, weight = design.reshape(m * k, -1), 1.0 / error_sd.ravel()
    scaled = flat * weight[:, None]
    covariance = np.linalg.inv(scaled.T @ scaled)
    found = covariance @ (scaled.T @ (mean.ravel() * weight))
    residual = (mean.ravel() - flat @ found) * weight
    freedom = m * k - flat.shape[1]
    misfit = float(residual @ residual) / freedom
    widened = covariance * max(misfit, 1.0)
    root = np.zeros((m, k, 3))
    for d in range(m):
        which = [0, 1 + 2 * d, 2 + 2 * d]
        root[d] = design[d][:, which] @ np.linalg.cholesky(widened[np.ix_(which, which)])
    return RingCurve((flat @ found).reshape(m, k), root, misfit, freedom)
