"""Rung L5: finite strain on the bead's axis, for what small strain leaves out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.mechanics.contact.bead_squares import Progress
from palp_core.mechanics.contact.cache import Arrays, cached
from palp_core.mechanics.contact.ranges import require_range
from palp_core.mechanics.contact.table import EnergyTable, energy_table
from palp_core.mechanics.phantom import Phantom
from palp_core.methods import Bound, method
from palp_core.units import Float64Array

__all__ = ["FiniteStrainContact"]

_ROOTS = 12  # indentations up to the ball's radius, uniform in their square roots
_FIRST = 3  # below this one the contact spans too few facets; Hertz's limit takes over
_FEWEST = 5
_FACETS = 16  # per radius of the ball


@method(
    task="contact",
    name="l5",
    cost_s=10.0,
    bounds=[Bound("normal_on_axis", 0.01)],
    evidence="tests/mechanics/test_l5.py",
    valid={
        "depth_m": (0.0005, 0.015),
        "modulus_pa": (1.0, 1e9),
        "poisson": (0.3, 0.4999),
        "height_m": (0.015, 0.060),
        "bead_radius_m": (0.002, 0.012),
        "tip_radius_m": (0.002, 0.012),
    },
    fails="away from the bead's axis, where it has no force; where the gel's elements fold",
)
@dataclass(frozen=True)
class FiniteStrainContact:
    """Frictionless contact of a sphere with a neo-Hookean layer, over the centre of a rigid bead or bare gel.

    Axisymmetric finite elements follow the equilibrium from no contact up to the ball's radius, or to where
    an element folds or the gel gives way: :attr:`indentation_max_m` says how far that was. Over a bead only
    the offset 0 is known; there the lateral force is 0 by symmetry. Bare gel answers at any offset.

    The first use of a phantom takes seconds; what it finds is kept in the cache on disk.

    Attributes:
        phantom: What is touched.
        tip_radius_m: Radius of the ball.
        progress: Told how far the set-up is.

    Raises:
        OutOfRange: The phantom or the ball is outside the range that the rung is stated for.
    """

    phantom: Phantom
    tip_radius_m: float
    progress: Progress | None = None

    def __post_init__(self) -> None:
        require_range(self.phantom, self.tip_radius_m)

    @property
    def rung(self) -> str:
        """Name in the register."""
        return "l5"

    @property
    def reach_m(self) -> float:
        """Offset up to which the rung would have to know the bead; it knows the axis alone."""
        bead = self.phantom.bead
        return 0.0 if bead is None else 2.0 * bead.centre_depth_m + self.tip_radius_m

    @property
    def indentation_max_m(self) -> float:
        """Indentation up to which the equilibrium could be followed, at most the ball's radius."""
        return self._table.root_max**2

    def prepare(self) -> None:
        """Do the set-up now, or read it from the cache."""
        _ = self._table

    def force(self, offset_m: Float64Array, indentation_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return (normal_n, lateral_n); see :class:`~palp_core.mechanics.contact.model.ContactModel`.

        Raises:
            OutOfRange: Besides that, an offset from the bead's axis.
        """
        offset_m, indentation_m = self._checked(offset_m, indentation_m)
        normal, lateral = self._table.force(offset_m, indentation_m)
        return normal * self.phantom.modulus_pa, lateral

    def energy(self, offset_m: Float64Array, indentation_m: Float64Array) -> Float64Array:
        """Return U in J; see :meth:`force`."""
        offset_m, indentation_m = self._checked(offset_m, indentation_m)
        return self._table.energy(offset_m, indentation_m) * self.phantom.modulus_pa

    def _checked(
        self, offset_m: Float64Array, indentation_m: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        offset_m = np.asarray(offset_m, dtype=np.float64)
        indentation_m = np.asarray(indentation_m, dtype=np.float64)
        if np.any(np.isnan(offset_m)) or (self.phantom.bead is not None and np.any(offset_m != 0.0)):
            raise OutOfRange(
                "offset_m",
                "l5 is axisymmetric: it knows no lateral force and nothing off the bead's axis; "
                "ask at offset 0 or use l4",
            )
        if not np.all(indentation_m <= self.indentation_max_m * (1.0 + 1e-12)):
            raise OutOfRange(
                "indentation_m",
                f"{np.max(indentation_m):g} is beyond {self.indentation_max_m:g}, where the finite elements "
                "of l5 fold or the ball is in up to its radius; press less deep",
            )
        return offset_m, indentation_m

    @cached_property
    def _table(self) -> EnergyTable:
        phantom, bead = self.phantom, self.phantom.bead
        inputs = {
            "poisson": phantom.poisson,
            "height_m": phantom.height_m,
            "tip_radius_m": self.tip_radius_m,
            "bead_radius_m": 0.0 if bead is None else bead.radius_m,
            "depth_m": 0.0 if bead is None else bead.depth_m,
        }
        kept = cached("l5-table", inputs, self._tabulate)
        return EnergyTable(0.0, float(kept["root_max"]), kept["pieces"])

    def _tabulate(self) -> Arrays:
        from palp_core.mechanics.contact.finite_strain import pressed_solid  # finite elements, if need be

        solid = pressed_solid(self.phantom, self.tip_radius_m, self.tip_radius_m / _FACETS)
        roots, scaled = [0.0], [4.0 / 3.0 * math.sqrt(self.tip_radius_m) / (1.0 - self.phantom.poisson**2)]
        for j in range(_FIRST, _ROOTS + 1):
            root = math.sqrt(self.tip_radius_m) * j / _ROOTS
            normal = solid.press(root**2)
            if self.progress is not None:
                self.progress(j, _ROOTS, "indentations at finite strain")
            if normal is None:
                break
            roots.append(root)
            scaled.append(normal / root**3)
        if len(roots) < _FEWEST:
            raise MechanicsError(
                f"the gel over the bead folds before {root**2:g} m of indentation; use a deeper bead or l4"
            )
        at = np.linspace(0.0, roots[-1], _ROOTS + 1)
        curve = CubicSpline(roots, scaled)
        table = energy_table(0.0, roots[-1], (curve(at[1:]) * at[1:] ** 3)[None, :], scaled[0])
        return {"root_max": np.array(table.root_max), "pieces": table.pieces}
