"""What every contact rung offers to the equilibrium of the probe, and where the finite-element rungs hold."""

from typing import Protocol

from palp_core.palpation.mechanics.limits import require
from palp_core.palpation.mechanics.phantom import Phantom
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


FEM_SCENES = {
    "depth_m": (0.0005, 0.015),
    "poisson": (0.3, 0.4999),
    "height_m": (0.015, 0.060),
    "bead_radius_m": (0.002, 0.012),
    "tip_radius_m": (0.002, 0.012),
}
"""The scenes that the finite-element rungs are stated for: inclusive range per quantity."""


def require_range(phantom: Phantom, tip_radius_m: float) -> None:
    """Check that a scene is one that the finite-element rungs are stated for.

    Raises:
        OutOfRange: A quantity is outside the range; the message names it.
    """
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
