"""Rung L3: plane strain, for testing methods. A cylinder is not a sphere, nor are its forces."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from palp_core.errors import OutOfRange
from palp_core.methods import method
from palp_core.palpation.mechanics.contact.active_set import solve_contact
from palp_core.palpation.mechanics.contact.model import FEM_SCENES, require_range
from palp_core.palpation.mechanics.limits import finite_offsets, require
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.palpation.mechanics.tip import TipForm, require_form
from palp_core.units import Float64Array

if TYPE_CHECKING:
    from palp_core.palpation.mechanics.contact.plane import PlaneSolid


@method(
    task="contact",
    name="l3",
    cost_s=3.3,
    evidence="tests/palpation/mechanics/contact/test_l3.py",
    valid=FEM_SCENES,
    fails="as a model of a ball and a bead: it is one of two cylinders, and vouches for nothing",
    survivor="l4",
    reference="for tests of methods: a cylinder on a section, not a ball on a gel",
)
@dataclass(frozen=True)
class PlaneContact:
    """Frictionless contact of a cylinder, taken as a parabola, with gel over a rigid cylinder.

    Finite elements are condensed once to the compliance C of the surface's nodes; each force then is one
    active set, U = max over p >= 0 of p.g - p.C p / 2 with the overlap g = delta - (x - s)^2 / (2 R), whose
    derivatives are N = sum p and U_s = p.(x - s) / R. There are up to 0.3 ms of them per position. The
    section is a parabola, whatever the ball's form: runs say so.

    Attributes:
        phantom: What is touched.
        tip_radius_m: Radius of the cylinder.
        thickness_m: Extent across the section; the ball's diameter by default, assumed.
        facet_m: Length of the surface's facets, each of two node spacings.
        tip: Form of the ball, which a parabola stands for.

    Raises:
        OutOfRange: The phantom or the tip is outside the range that the rung is stated for, or there is no
            such form.
    """

    phantom: Phantom
    tip_radius_m: float
    thickness_m: float | None = None
    facet_m: float = 0.001
    tip: TipForm = field(default="sphere", kw_only=True)

    def __post_init__(self) -> None:
        require_form(self.tip)
        require_range(self.phantom, self.tip_radius_m)
        require("thickness_m", self._thickness_m, 1e-6, 1.0, "give the section's extent in metres")
        require("facet_m", self.facet_m, 0.0002, 0.002, "use facets of 0.2 to 2 mm")

    @property
    def rung(self) -> str:
        """Name in the register."""
        return "l3"

    @property
    def reach_m(self) -> float:
        """Offset at which the bead is hardly felt any more."""
        bead = self.phantom.bead
        return 0.0 if bead is None else 1.5 * bead.centre_depth_m + self.tip_radius_m

    @property
    def indentation_max_m(self) -> float:
        """The tip's radius, beyond which no parabola stands for it."""
        return self.tip_radius_m

    def force(self, offset_m: Float64Array, indentation_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return (normal_n, lateral_n); see :class:`.ContactModel`."""
        normal, lateral, _ = self._solved(offset_m, indentation_m)
        return normal, lateral

    def energy(self, offset_m: Float64Array, indentation_m: Float64Array) -> Float64Array:
        """Return U in J; see :class:`~palp_core.palpation.mechanics.contact.model.ContactModel`."""
        return self._solved(offset_m, indentation_m)[2]

    @property
    def _thickness_m(self) -> float:
        return 2.0 * self.tip_radius_m if self.thickness_m is None else self.thickness_m

    @cached_property
    def solid(self) -> PlaneSolid:
        """The finite elements, meshed."""
        from palp_core.palpation.mechanics.contact.plane import (
            PlaneSolid,  # finite elements, if it comes to that
        )
        from palp_core.palpation.mechanics.contact.section_mesh import bead_section, slab_section

        bead, height_m = self.phantom.bead, self.phantom.height_m
        contact_m = self.reach_m + 1.5 * self.tip_radius_m
        if bead is not None:
            section = bead_section(bead.radius_m, bead.depth_m, height_m, 1.0, contact_m, self.facet_m)
        else:
            near = np.linspace(0.0, contact_m, round(contact_m / self.facet_m) + 1)
            far = np.geomspace(contact_m, contact_m + 4.0 * height_m, 12)
            rows = np.concatenate([[0.0], np.cumsum(np.geomspace(1.0, 6.0, 12))])
            section = slab_section(height_m, np.concatenate([near, far[1:]]), rows * (height_m / rows[-1]))
        return PlaneSolid(section, self.phantom.poisson, contact_m)

    def _solved(
        self, offset_m: Float64Array, indentation_m: Float64Array
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        offset_m, indentation_m = np.broadcast_arrays(
            np.asarray(offset_m, dtype=np.float64), np.asarray(indentation_m, dtype=np.float64)
        )
        if not np.all(indentation_m <= self.indentation_max_m):
            raise OutOfRange(
                "indentation_m",
                f"{np.max(indentation_m):g} is not below {self.indentation_max_m:g}, the tip's radius; "
                "press less deep",
            )
        finite_offsets(offset_m)
        indentation_m = np.maximum(indentation_m, 0.0)
        place_m, scale = self.solid.place_m, self.phantom.modulus_pa * self._thickness_m
        result = np.zeros((3, *offset_m.shape))
        for index in np.ndindex(offset_m.shape):
            # Beyond its reach the bead is not felt: the tip stays where the nodes are.
            offset = float(np.clip(offset_m[index], -self.reach_m, self.reach_m))
            aside = place_m - offset
            overlap = float(indentation_m[index]) - aside**2 / (2.0 * self.tip_radius_m)
            # Only what overlaps can touch, and its surroundings where the gel is squeezed out.
            near = np.flatnonzero(aside**2 <= 9.0 * self.tip_radius_m * float(indentation_m[index]))
            if near.size:
                force = solve_contact(self.solid.compliance[np.ix_(near, near)], overlap[near])
                beyond = abs(float(offset_m[index])) > self.reach_m
                lateral = 0.0 if beyond else float(force @ aside[near]) / self.tip_radius_m
                result[(slice(None), *index)] = (force.sum(), lateral, 0.5 * float(force @ overlap[near]))
        result *= scale
        return result[0], result[1], result[2]
