"""Rung L5: finite strain, for what small strain leaves out; off the bead's axis with L4's shape."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
import scipy

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics.contact.cache import Arrays, cached
from palp_core.palpation.mechanics.contact.l4 import HarmonicContact
from palp_core.palpation.mechanics.contact.model import require_range
from palp_core.palpation.mechanics.contact.table import EnergyTable, energy_table
from palp_core.palpation.mechanics.limits import finite_places, require
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.units import Float64Array

_ROOTS = 12  # indentations up to the ball's radius, uniform in their square roots
_FIRST = 3  # below this one the contact spans too few facets; small strain (L4) is the limit
_FEWEST = 5
_FACETS = 16  # per radius of the ball, unless another length is asked for
_SHALLOWEST = 1.0 / 144.0  # of the ball's radius: the first indentation that L4 solves


@dataclass(frozen=True)
class FiniteStrainContact:
    """Frictionless contact of a ball with a neo-Hookean layer, over the centre of a rigid bead or bare gel.

    Axisymmetric finite elements follow the equilibrium from no contact up to the ball's radius, or to where
    an element folds or the gel gives way: :attr:`indentation_max_m` says how far that was. That is the
    energy U_axis over the bead and U_bare over bare gel. Between the two, where nothing is axisymmetric, what
    the bead adds falls off as it does at small strain, in L4::

        U(s, delta) = U_bare + P (U_axis - U_bare),    P(s, delta) = (U4(s) - U4_bare) / (U4(0) - U4_bare)

    which is exact on the axis and far from it; in between, over the published phantom, finite elements in
    three dimensions have the same normal force within 1 %. Both forces are this energy's slopes.

    The first use of a phantom takes seconds; what it finds is kept in the cache on disk.

    Attributes:
        phantom: What is touched.
        tip_radius_m: Radius of the ball.
        facet_m: Length of the surface's facets where the ball may touch; 1/16 of its radius by default.

    Raises:
        OutOfRange: The phantom or the ball is outside the range that the rung is stated for.
    """

    rung: ClassVar[str] = "l5"
    phantom: Phantom
    tip_radius_m: float
    facet_m: float | None = None

    def __post_init__(self) -> None:
        require_range(self.phantom, self.tip_radius_m)
        require(
            "facet_m", self._facet_m, self.tip_radius_m / 64.0, self.tip_radius_m / 4.0, "use R/64 to R/4"
        )

    @property
    def _facet_m(self) -> float:
        return self.tip_radius_m / _FACETS if self.facet_m is None else self.facet_m

    @property
    def reach_m(self) -> float:
        """Offset at which the bead is no longer felt, that of L4."""
        return self._small.reach_m

    @property
    def indentation_max_m(self) -> float:
        """Indentation up to which the equilibrium could be followed, at most the ball's radius."""
        return min(min(self._table.root_max, self._bare.root_max) ** 2, self.tip_radius_m)

    def prepare(self) -> None:
        """Do the set-up now, or read it from the cache."""
        _ = self._table, self._bare
        self._small.prepare()

    def force(self, offset_m: Float64Array, indentation_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        offset_m, indentation_m = self._checked(offset_m, indentation_m)
        axis_n, none = self._table.force(offset_m, indentation_m)
        if not self._aside(offset_m):
            return axis_n * self.phantom.modulus_pa, none
        bare_n, _ = self._bare.force(offset_m, indentation_m)
        extra = self._table.energy(offset_m, indentation_m) - self._bare.energy(offset_m, indentation_m)
        share, by_indentation, by_offset = self._spread(offset_m, indentation_m)
        normal_n = bare_n + share * (axis_n - bare_n) + by_indentation * extra
        return normal_n * self.phantom.modulus_pa, by_offset * extra * self.phantom.modulus_pa

    def energy(self, offset_m: Float64Array, indentation_m: Float64Array) -> Float64Array:
        offset_m, indentation_m = self._checked(offset_m, indentation_m)
        axis_j = self._table.energy(offset_m, indentation_m)
        if self._aside(offset_m):
            bare_j = self._bare.energy(offset_m, indentation_m)
            axis_j = bare_j + self._spread(offset_m, indentation_m)[0] * (axis_j - bare_j)
        return axis_j * self.phantom.modulus_pa

    def _aside(self, offset_m: Float64Array) -> bool:
        return self.phantom.bead is not None and bool(np.any(offset_m != 0.0))

    def _spread(
        self, offset_m: Float64Array, indentation_m: Float64Array
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return P(s, delta), dP/d(delta) and dP/ds; below the first indentation of L4, those there."""
        shallowest_m = _SHALLOWEST * self.tip_radius_m
        at_m, axis = np.clip(indentation_m, shallowest_m, self.tip_radius_m), np.zeros(())
        small, bare = self._small, self._small_bare
        bare_j, (bare_n, _) = bare.energy(axis, at_m), bare.force(axis, at_m)
        extra_j, whole_j = small.energy(offset_m, at_m) - bare_j, small.energy(axis, at_m) - bare_j
        normal_n, lateral_n = small.force(offset_m, at_m)
        share = extra_j / whole_j
        slope = (normal_n - bare_n - share * (small.force(axis, at_m)[0] - bare_n)) / whole_j
        return share, np.where(indentation_m > shallowest_m, slope, 0.0), lateral_n / whole_j

    def _checked(
        self, offset_m: Float64Array, indentation_m: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        advice = "where the finite elements of l5 fold or the ball is in up to its radius; press less deep"
        return finite_places(offset_m, indentation_m, self.indentation_max_m * (1.0 + 1e-12), advice)

    @cached_property
    def _table(self) -> EnergyTable:
        return self._tabulated(self._small)

    @cached_property
    def _bare(self) -> EnergyTable:
        return self._table if self.phantom.bead is None else self._tabulated(self._small_bare)

    @cached_property
    def _small(self) -> HarmonicContact:
        return HarmonicContact(self.phantom, self.tip_radius_m)

    @cached_property
    def _small_bare(self) -> HarmonicContact:
        return replace(self._small, phantom=replace(self.phantom, bead=None))

    def _tabulated(self, small: HarmonicContact) -> EnergyTable:
        inputs = {**small.geometry, "facet_m": self._facet_m}
        kept = cached("l5-table", inputs, lambda: self._tabulate(small))
        return EnergyTable(0.0, float(kept["root_max"]), kept["pieces"])

    def _tabulate(self, small: HarmonicContact) -> Arrays:
        """Follow the equilibrium; between the indentations solved, its share of L4's force is smooth."""
        from palp_core.palpation.mechanics.contact.finite_strain import (
            pressed_solid,  # finite elements, if need be
        )

        def small_n(root: Float64Array) -> Float64Array:
            at_m = np.minimum(root**2, self.tip_radius_m)  # the last root's square may be the next number
            return small.force(np.zeros(()), at_m)[0] / small.phantom.modulus_pa

        solid = pressed_solid(small.phantom, self.tip_radius_m, self._facet_m)
        roots, shares = [0.0], [1.0]
        for j in range(_FIRST, _ROOTS + 1):
            root = math.sqrt(self.tip_radius_m) * j / _ROOTS
            normal = solid.press(root**2)
            if normal is None:
                break
            roots.append(root)
            shares.append(normal / float(small_n(np.array(root))))
        if len(roots) < _FEWEST:
            raise MechanicsError(
                f"the gel over the bead folds before {root**2:g} m of indentation; use a deeper bead or l4"
            )
        at = np.linspace(0.0, roots[-1], _ROOTS + 1)[1:]
        normal_n = scipy.interpolate.CubicSpline(roots, shares)(at) * small_n(at)
        hertz = 4.0 / 3.0 * math.sqrt(self.tip_radius_m) / (1.0 - small.phantom.poisson**2)
        table = energy_table(0.0, roots[-1], normal_n[None, :], hertz)
        return {"root_max": np.array(table.root_max), "pieces": table.pieces}
