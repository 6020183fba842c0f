"""Rung L1: an elastic foundation. Every column of gel under the ball is squeezed by itself."""

import math
from dataclasses import dataclass, field

import numpy as np

from palp_core.errors import OutOfRange
from palp_core.methods import Bound, method
from palp_core.palpation.mechanics.limits import finite_offsets, require
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.palpation.mechanics.tip import TipForm, require_form
from palp_core.units import Float64Array

POISSON_MAX = 0.4995
"""Beyond it the confined modulus is over 300 times Young's, and the rung has nothing to say."""

_NODES = 16


@method(
    task="contact",
    name="l1",
    cost_s=0.018,
    bounds=[Bound("normal", 0.03, within={"height_m": (0.0, 0.002), "poisson": (0.0, 0.4)})],
    evidence="tests/palpation/mechanics/contact/test_l1.py: the thin bonded compressible layer; "
    "measured by palp methods measure --task contact",
    valid={
        "poisson": (0.0, 0.45),
        "indentation_m": (0.0, 0.005),
        "tip_radius_m": (0.002, 0.012),
    },
    fails="forces several times too high on thick gel; the modulus of a column diverges as nu -> 0.5",
    survivor="l2",
    reference="for teaching; on any gel that is touched in earnest its forces are several times too high",
)
@dataclass(frozen=True)
class ElasticFoundation:
    """Bonded elastic foundation with the local thickness of the gel: for teaching, not for numbers.

    The pressure is p = M w / h with w = delta - r^2 / 2R the squeeze, M = E (1 - nu) / ((1 + nu)(1 - 2 nu))
    the confined modulus (Johnson, Contact Mechanics, section 4.3) and h the gel under that point: H, or
    d + R_n - sqrt(R_n^2 - r^2) over a bead that does not sink. Forces are integrals over the circle of radius
    sqrt(2 R delta). The ball is a paraboloid, whatever its form: runs say so.

    Attributes:
        phantom: What is touched.
        tip_radius_m: Radius of the ball.
        tip: Form of the ball, which a paraboloid stands for.

    Raises:
        OutOfRange: The radius is not positive, there is no such form, or the gel is too nearly
            incompressible.
    """

    phantom: Phantom
    tip_radius_m: float
    tip: TipForm = field(default="sphere", kw_only=True)

    def __post_init__(self) -> None:
        require_form(self.tip)
        require("tip_radius_m", self.tip_radius_m, 1e-6, 1.0, "give the ball's radius in metres, as in 0.006")
        require(
            "poisson",
            self.phantom.poisson,
            0.0,
            POISSON_MAX,
            "the modulus of a confined column diverges towards 0.5; use l2 or l4",
        )

    @property
    def rung(self) -> str:
        """Name in the register."""
        return "l1"

    @property
    def reach_m(self) -> float:
        """Radius of the bead and of the largest contact."""
        bead = self.phantom.bead
        contact_m = math.sqrt(2.0 * self.tip_radius_m * self.indentation_max_m)
        return 0.0 if bead is None else bead.radius_m + contact_m

    @property
    def indentation_max_m(self) -> float:
        """The ball's radius, beyond which no paraboloid stands for it."""
        return self.tip_radius_m

    @property
    def column_modulus_pa(self) -> float:
        """Modulus M of a column that cannot widen."""
        nu = self.phantom.poisson
        return self.phantom.modulus_pa * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu))

    def force(self, offset_m: Float64Array, indentation_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return (normal_n, lateral_n); see :class:`.ContactModel`."""
        parts = self._integrals(offset_m, indentation_m)
        return parts[0], parts[1]

    def energy(self, offset_m: Float64Array, indentation_m: Float64Array) -> Float64Array:
        """Return U in J; see :class:`~palp_core.palpation.mechanics.contact.model.ContactModel`."""
        return self._integrals(offset_m, indentation_m)[2]

    def _integrals(
        self, offset_m: Float64Array, indentation_m: Float64Array
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return N, U_s and U: bare gel in closed form, and what the bead adds."""
        given = np.asarray(indentation_m, dtype=np.float64)
        if not np.all(given <= self.indentation_max_m):
            raise OutOfRange(
                "indentation_m",
                f"{np.max(given):g} is not below {self.indentation_max_m:g}, the ball's radius; "
                "press less deep or use a finite-strain rung",
            )
        offset, depth = np.broadcast_arrays(finite_offsets(offset_m), np.maximum(given, 0.0))
        bare = self.column_modulus_pa * math.pi * self.tip_radius_m / self.phantom.height_m
        sums = np.stack([bare * depth**2, np.zeros(depth.shape), bare * depth**3 / 3.0])
        near = (depth > 0.0) & (np.abs(offset) < self._edge(depth))
        if near.any():
            sums[:, near] += self._extra(np.abs(offset[near]), depth[near]) * np.stack(
                [np.ones(near.sum()), np.sign(offset[near]), np.ones(near.sum())]
            )
        return sums[0], sums[1], sums[2]

    def _edge(self, depth_m: Float64Array) -> Float64Array:
        """Return the offset from which on the contact does not overlap the bead."""
        bead = self.phantom.bead
        contact_m: Float64Array = np.sqrt(2.0 * self.tip_radius_m * depth_m)
        return np.zeros_like(contact_m) if bead is None else contact_m + bead.radius_m

    def _extra(self, offset_m: Float64Array, depth_m: Float64Array) -> Float64Array:
        """Integrate over the bead's disc, ring by ring: the thickness depends on the ring's radius only.

        On the ring of radius r the squeeze is A + B cos(phi), A = delta - (r^2 + s^2) / 2R, B = r s / R, and
        its moments over the part in contact are closed forms. The radius is integrated by Gauss in u with
        r = low + (high - low) sin^2(pi u / 2), which takes the square roots at the ends; a panel ends
        where the ring begins to leave the contact.
        """
        bead = self.phantom.bead
        if bead is None:
            return np.zeros((3, len(offset_m)))
        tip_m = self.tip_radius_m
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        u = 0.5 * (nodes + 1.0)
        share, weights = np.sin(0.5 * math.pi * u) ** 2, 0.25 * math.pi * weights * np.sin(math.pi * u)
        contact_m = np.sqrt(2.0 * tip_m * depth_m)
        ends = np.stack([np.zeros_like(offset_m), np.abs(contact_m - offset_m), offset_m + contact_m])
        ends = np.minimum(ends, bead.radius_m)[:, :, None]
        total = np.zeros((3, len(offset_m)))
        s, depth = offset_m[:, None], depth_m[:, None]
        for low, high in ((ends[0], ends[1]), (ends[1], ends[2])):
            r = low + (high - low) * share
            above = np.sqrt(np.maximum(bead.radius_m**2 - r**2, 0.0))
            excess = 1.0 / (bead.centre_depth_m - above) - 1.0 / self.phantom.height_m
            area = self.column_modulus_pa * excess * r * (high - low) * weights
            a, b = depth - (r**2 + s**2) / (2.0 * tip_m), r * s / tip_m
            to = np.arccos(np.clip(-a / np.maximum(b, 1e-300), -1.0, 1.0))
            sine, twice = np.sin(to), np.sin(2.0 * to)
            plain = 2.0 * (a * to + b * sine)
            along = 2.0 * (a * sine + b * (0.5 * to + 0.25 * twice))
            square = 2.0 * ((a * a + 0.5 * b * b) * to + 2.0 * a * b * sine + 0.25 * b * b * twice)
            total[0] += np.sum(area * plain, axis=1)
            total[1] += np.sum(area * (r * along - s * plain), axis=1) / tip_m
            total[2] += 0.5 * np.sum(area * square, axis=1)
        return total
