"""Rung L4: three dimensions, small strain. Layer in closed form, bead by finite elements."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from palp_core.palpation.mechanics.contact.cache import Arrays, cached
from palp_core.palpation.mechanics.contact.layer import BondedLayer
from palp_core.palpation.mechanics.contact.model import require_range
from palp_core.palpation.mechanics.contact.patch import BeadTerm, Patch
from palp_core.palpation.mechanics.contact.table import EnergyTable, energy_table
from palp_core.palpation.mechanics.limits import finite_places, require
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.palpation.mechanics.tip import contact_radius_m
from palp_core.units import Float64Array

_ROOTS = 12  # indentations in the table, uniform in their square roots
_UNIT_M = 0.005  # radius of the contact on a half-space at which the cells have their nominal size
_LARGEST = 1.5  # cells over their nominal size


@dataclass(frozen=True)
class HarmonicContact:
    """Frictionless contact of a rigid ball with a bonded layer and a rigid bead that is free to move with it.

    The surface's compliance is that of a half-space (Love) and its correction for the bonded floor (Hankel
    transform), less the bead's stiffening, a sum of squares from Fourier-harmonic finite elements. The
    contact is solved by active set on cells around the ball, for a grid of offsets and indentations; the
    energy is tabulated, and both forces are the table's exact derivatives. Everything is linear in Young's
    modulus.

    The first use of a phantom takes seconds; what it finds is kept in the cache on disk.

    Attributes:
        phantom: What is touched.
        tip_radius_m: Radius of the ball.
        cell_m: Side of the cells where the contact on a half-space has a radius of 5 mm, in proportion to it
            below and up to 7.5 mm.

    Raises:
        OutOfRange: The phantom or the ball is outside the range that the rung is stated for.
    """

    rung: ClassVar[str] = "l4"
    phantom: Phantom
    tip_radius_m: float
    cell_m: float = 0.001

    def __post_init__(self) -> None:
        require_range(self.phantom, self.tip_radius_m)
        require("cell_m", self.cell_m, 0.0002, 0.002, "use cells of 0.2 to 2 mm")

    @property
    def reach_m(self) -> float:
        """Offset at which the bead is no longer felt."""
        bead = self.phantom.bead
        return 0.0 if bead is None else 2.0 * bead.centre_depth_m + self.tip_radius_m

    @property
    def indentation_max_m(self) -> float:
        return self.tip_radius_m

    @property
    def _far_m(self) -> float:
        """Offset from which on the table holds its last row: the bead changes N by less than 0.1 %."""
        bead = self.phantom.bead
        return 0.0 if bead is None else 3.0 * bead.centre_depth_m + self.tip_radius_m

    @property
    def geometry(self) -> dict[str, float]:
        """What a table for Young's modulus 1 depends on; the bead's lengths are 0 without one."""
        phantom, bead = self.phantom, self.phantom.bead
        return {
            "poisson": phantom.poisson,
            "height_m": phantom.height_m,
            "tip_radius_m": self.tip_radius_m,
            "bead_radius_m": 0.0 if bead is None else bead.radius_m,
            "depth_m": 0.0 if bead is None else bead.depth_m,
        }

    def prepare(self) -> None:
        """Do the set-up now, or read it from the cache."""
        _ = self._table

    def force(self, offset_m: Float64Array, indentation_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        offset_m, indentation_m = self._checked(offset_m, indentation_m)
        normal, lateral = self._table.force(offset_m, indentation_m)
        return normal * self.phantom.modulus_pa, lateral * self.phantom.modulus_pa

    def energy(self, offset_m: Float64Array, indentation_m: Float64Array) -> Float64Array:
        offset_m, indentation_m = self._checked(offset_m, indentation_m)
        return self._table.energy(offset_m, indentation_m) * self.phantom.modulus_pa

    def _checked(
        self, offset_m: Float64Array, indentation_m: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        advice = "the ball's radius; press less deep"
        return finite_places(offset_m, indentation_m, self.indentation_max_m, advice)

    @cached_property
    def _table(self) -> EnergyTable:
        inputs = {**self.geometry, "cell_m": self.cell_m}
        kept = cached("l4-table", inputs, self._tabulate)
        return EnergyTable(float(kept["offset_max_m"]), float(kept["root_max"]), kept["pieces"])

    def patch(self, indentation_m: float) -> Patch:
        """Return the ball on its cells at an indentation, for Young's modulus 1."""
        bead = self.phantom.bead
        contact_m = contact_radius_m(self.tip_radius_m, indentation_m)
        return Patch(
            BondedLayer(self.phantom.poisson, self.phantom.height_m),
            self._bead,
            self.tip_radius_m,
            indentation_m,
            self.cell_m * min(_LARGEST, contact_m / _UNIT_M),
            math.inf if bead is None else bead.depth_m,
        )

    @cached_property
    def _bead(self) -> BeadTerm | None:
        phantom, bead = self.phantom, self.phantom.bead
        if bead is None:
            return None
        inputs = {
            "radius_m": bead.radius_m,
            "depth_m": bead.depth_m,
            "height_m": phantom.height_m,
            "poisson": phantom.poisson,
            "reach_m": self._far_m + 2.0 * self.tip_radius_m,
        }

        def compute() -> Arrays:
            from palp_core.palpation.mechanics.contact.bead_term import (
                bead_term,
            )  # finite elements, if it comes to that

            term = bead_term(**inputs)
            return {"radius_m": term.radius_m, "harmonic": term.harmonic, "squares": term.squares}

        return BeadTerm(**cached("l4-bead", inputs, compute))

    def _tabulate(self) -> Arrays:
        bead = self.phantom.bead
        step_m = 0.001 if bead is None else min(0.001, 0.1 * bead.centre_depth_m + 0.05 * self.tip_radius_m)
        offsets = np.linspace(0.0, self._far_m, 1 + math.ceil(self._far_m / step_m))
        root_max = math.sqrt(self.indentation_max_m)
        roots = np.linspace(0.0, root_max, _ROOTS + 1)[1:]
        normal = np.empty((offsets.size, roots.size))
        for j, root in enumerate(roots):
            patch, touching = self.patch(root**2), None
            for i, offset in enumerate(offsets):
                pressed = patch.press(offset, touching)
                normal[i, j], touching = pressed.normal_n, pressed.force_n > 0.0
        first = 4.0 / 3.0 * math.sqrt(self.tip_radius_m) / (1.0 - self.phantom.poisson**2)
        table = energy_table(self._far_m, root_max, normal, first)
        return {
            "offset_max_m": np.array(table.offset_max_m),
            "root_max": np.array(table.root_max),
            "pieces": table.pieces,
        }
