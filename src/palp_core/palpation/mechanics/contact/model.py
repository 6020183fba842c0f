"""What every contact rung offers to the equilibrium of the probe."""

from __future__ import annotations

from typing import Protocol

from palp_core.units import Float64Array


class ContactModel(Protocol):
    """Elastic, frictionless contact of the ball with a phantom, as a function of where the ball is.

    A rung is declared in the register under task ``contact``; its target is called as
    ``target(phantom, tip_radius_m)`` and returns an object of this protocol. The forces derive from one
    energy U(s, delta): the normal force is dU/d(delta), the lateral force is dU/ds.
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
            The normal force, never negative, and the lateral force dU/ds, positive where going
            on costs energy. Both are zero above the surface.

        Raises:
            OutOfRange: An indentation is not a number or beyond ``indentation_max_m``.
        """
        ...

    def energy(self, offset_m: Float64Array, indentation_m: Float64Array) -> Float64Array:
        """Return the elastic energy U in J; arguments, shape and errors as for :meth:`force`."""
        ...
