"""Rung L0: a bump on a bare force, fitted to measured forces or to another rung. No mechanics in it."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
import scipy
from numpy.typing import ArrayLike

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics.contact.l2 import LayeredHertz
from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.limits import finite_places, require
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.units import Float64Array

_WORKING_POINT = (0.55, 1.0)  # share of the nominal indentation that a yielding joint leaves, and all of it
_NOMINAL_M = 0.004


@dataclass(frozen=True, kw_only=True)
class Bump:
    """N(s, delta) = (k_1 delta^1.5 + k_2 delta^2.5) (1 + A exp(-s^2 / 2 w^2)).

    Attributes:
        stiffness: k_1 in N/m^1.5 and k_2 in N/m^2.5, both fitted.
        rise: A, the bead's share over its top.
        width_m: w.
        within_m: Indentations it was fitted over.
        residual: Largest error of the fit, of the largest force.
    """

    stiffness: tuple[float, float]
    rise: float
    width_m: float
    within_m: tuple[float, float]
    residual: float


def fit_bump(offset_m: ArrayLike, indentation_m: ArrayLike, normal_n: ArrayLike) -> Bump:
    """Fit a bump to normal forces, measured or computed.

    Args:
        offset_m: Positions s, any shape.
        indentation_m: Indentations, positive; broadcast with the positions.
        normal_n: Forces, of the broadcast shape.

    Raises:
        MechanicsError: Fewer than six forces, one that is not a number, or none that rises over the bead.
    """
    s, d, n = (
        np.ravel(x) for x in np.broadcast_arrays(*map(np.asarray, (offset_m, indentation_m, normal_n)))
    )
    if n.size < 6 or not np.isfinite([s, d, n]).all() or np.any(d <= 0.0) or not np.any(n > 0.0):
        raise MechanicsError(
            "a bump needs six or more finite forces at positive indentations, not all of them 0"
        )
    s, d, n = s.astype(np.float64), d.astype(np.float64), n.astype(np.float64)
    deepest_m, strongest_n = float(d.max()), float(n.max())
    terms = np.stack([(d / deepest_m) ** 1.5, (d / deepest_m) ** 2.5])
    far = max(float(np.abs(s).max()), 1e-6)

    def off(x: Float64Array) -> Float64Array:
        shape = 1.0 + x[2] * np.exp(-0.5 * (s / (x[3] * far)) ** 2)
        difference: Float64Array = (x[0] * terms[0] + x[1] * terms[1]) * shape - n / strongest_n
        return difference

    found = scipy.optimize.least_squares(
        off, np.array([0.5, 0.1, 0.5, 0.3]), bounds=([0.0, -1.0, 0.0, 1e-3], [1e3, 1e3, 1e3, 10.0])
    )
    if not found.success:
        raise MechanicsError("no bump fits these forces; do they lie on both sides of one bead?")
    a, b, rise, width = (float(x) for x in found.x)
    return Bump(
        stiffness=(a * strongest_n / deepest_m**1.5, b * strongest_n / deepest_m**2.5),
        rise=rise,
        width_m=width * far,
        within_m=(float(d.min()), deepest_m),
        residual=float(np.abs(off(found.x)).max()),
    )


def fit_to(model: ContactModel, indentation_m: float = _NOMINAL_M) -> Bump:
    """Fit a bump to another rung about one working point: the indentations that a yielding joint leaves."""
    low, high = (share * min(indentation_m, model.indentation_max_m) for share in _WORKING_POINT)
    s, d = np.meshgrid(np.linspace(-0.03, 0.03, 61), np.linspace(low, high, 7), indexing="ij")
    return fit_bump(s, d, model.force(s, d)[0])


@dataclass(frozen=True)
class FittedBump:
    """The bump as a contact model: of a measured phantom if ``bump`` is given, else fitted to L2 at 4 mm.

    The energy is that of the force at each offset, so that the lateral force is its slope exactly.

    Attributes:
        phantom: What is touched.
        tip_radius_m: Radius of the ball.
        bump: The fit; None to fit L2.

    Raises:
        OutOfRange: L2 does not answer for this phantom.
    """

    rung: ClassVar[str] = "l0"
    phantom: Phantom
    tip_radius_m: float
    bump: Bump | None = None

    def __post_init__(self) -> None:
        require("tip_radius_m", self.tip_radius_m, 1e-6, 1.0, "give the ball's radius in metres, as in 0.006")
        _ = self.fit

    @cached_property
    def fit(self) -> Bump:
        """The bump in use."""
        return self.bump or fit_to(LayeredHertz(self.phantom, self.tip_radius_m))

    @property
    def reach_m(self) -> float:
        """Offset at which the bump has fallen to 1 %."""
        return 0.0 if self.phantom.bead is None else 3.04 * self.fit.width_m

    @property
    def indentation_max_m(self) -> float:
        """A fifth beyond what it was fitted over."""
        return 1.2 * self.fit.within_m[1]

    def force(self, offset_m: Float64Array, indentation_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        depth_m, bump, slope = self._parts(offset_m, indentation_m)
        one, two = self.fit.stiffness
        root = np.sqrt(depth_m)
        normal = (one + two * depth_m) * depth_m * root * bump
        return normal, (one / 2.5 + two / 3.5 * depth_m) * depth_m**2 * root * slope

    def energy(self, offset_m: Float64Array, indentation_m: Float64Array) -> Float64Array:
        depth_m, bump, _ = self._parts(offset_m, indentation_m)
        one, two = self.fit.stiffness
        return (one / 2.5 + two / 3.5 * depth_m) * depth_m**2 * np.sqrt(depth_m) * bump

    def _parts(
        self, offset_m: Float64Array, indentation_m: Float64Array
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return the indentation from 0 up, the bump's factor and its slope by offset, broadcast."""
        advice = "what the bump was fitted over; press less deep, fit deeper forces or climb to l2"
        offset, given = finite_places(offset_m, indentation_m, self.indentation_max_m, advice)
        width = self.fit.width_m
        extra = self.fit.rise * np.exp(-0.5 * (offset / width) ** 2)
        depth, bump = np.broadcast_arrays(np.maximum(given, 0.0), 1.0 + extra)
        return depth, bump, np.broadcast_to(-extra * offset / width**2, depth.shape)
