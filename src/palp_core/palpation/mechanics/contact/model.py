"""What every contact rung offers to the equilibrium of the probe, and where the finite-element rungs hold."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from palp_core.palpation.mechanics.limits import require
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.palpation.method_table.mechanics import FEM_SCENES
from palp_core.units import Float64Array


class ContactModel(Protocol):
    """Elastic, frictionless contact of the ball with a phantom, as a function of where the ball is.

    A rung is declared in the register under task ``contact``; its target is called as ``target(phantom,
    tip_radius_m)`` and returns an object of this protocol. The forces derive from one energy
    U(s, delta): the normal force is dU/d(delta), the lateral force is dU/ds.
    """

    @property
    def rung(self) -> str:
        """Name of the rung in the register, as in ``l2``."""
        ...

    @property
    def reach_m(self) -> float:
        """Lateral offset beyond which the bead changes the normal force by less than 1 %."""
        ...

    @property
    def indentation_max_m(self) -> float:
        """Largest indentation that the rung answers."""
        ...

    def force(self, offset_m: Float64Array, indentation_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return (normal_n, lateral_n) of the broadcast shape of the arguments.

        Args:
            offset_m: Position s of the ball's centre past the bead's, along the sweep.
            indentation_m: Depth delta of the ball's lowest point under the undeformed surface.

        Returns:
            The normal force, never negative, and the lateral force dU/ds, positive where going on costs
            energy. Both are zero above the surface.

        Raises:
            OutOfRange: An indentation is not a number or beyond ``indentation_max_m``.
        """
        ...

    def energy(self, offset_m: Float64Array, indentation_m: Float64Array) -> Float64Array:
        """Return the elastic energy U in J; arguments, shape and errors as for :meth:`force`."""
        ...


def require_range(phantom: Phantom, tip_radius_m: float) -> None:
    """Check that a scene is one that the finite-element rungs are stated for."""
    given = {
        "tip_radius_m": (tip_radius_m, "use a ball of 2 to 12 mm"),
        "poisson": (phantom.poisson, "use 0.4999 for an incompressible gel, or l2"),
        "height_m": (phantom.height_m, "use a slab of 15 to 60 mm, or l2"),
    }
    if phantom.bead is not None:
        given["depth_m"] = phantom.bead.depth_m, "use 0.5 to 15 mm; leave out a deeper bead"
        given["bead_radius_m"] = phantom.bead.radius_m, "use a bead of 2 to 12 mm"
    for quantity, (value, advice) in given.items():
        require(quantity, value, *FEM_SCENES[quantity], advice)


@dataclass(frozen=True, eq=False)
class BesideBead:
    """A contact model whose bead lies beside the path; the joint is rigid across the path."""

    model: ContactModel  # The contact, by distance from the bead
    beside_m: float  # Distance of the bead from the path

    @property
    def rung(self) -> str:
        return self.model.rung

    @property
    def reach_m(self) -> float:
        """Offset along the path beyond which the bead is not felt; at most that of the model."""
        return self.model.reach_m

    @property
    def indentation_max_m(self) -> float:
        return self.model.indentation_max_m

    def force(self, offset_m: Float64Array, indentation_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        away_m, along = distance(offset_m, self.beside_m**2)
        normal_n, lateral_n = self.model.force(away_m, indentation_m)
        return normal_n, lateral_n * along

    def energy(self, offset_m: Float64Array, indentation_m: Float64Array) -> Float64Array:
        return self.model.energy(distance(offset_m, self.beside_m**2)[0], indentation_m)


def distance(past_m: Float64Array, beside_m2: float | Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return the distance from a bead beside the path, and its change along the path."""
    away_m = np.sqrt(past_m * past_m + beside_m2)
    return away_m, np.divide(past_m, away_m, out=np.zeros_like(away_m), where=away_m > 0.0)
