"""A contact model swept along a path that passes beside the bead."""

from dataclasses import dataclass

import numpy as np

from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class BesideBead:
    """A contact model whose bead lies beside the path; the joint is rigid across the path.

    Attributes:
        model: The contact, by distance from the bead.
        beside_m: Distance of the bead from the path.
    """

    model: ContactModel
    beside_m: float

    @property
    def rung(self) -> str:
        """Name of the rung."""
        return self.model.rung

    @property
    def reach_m(self) -> float:
        """Offset along the path beyond which the bead is not felt; at most that of the model."""
        return self.model.reach_m

    @property
    def indentation_max_m(self) -> float:
        """Largest indentation that the model answers."""
        return self.model.indentation_max_m

    def force(self, offset_m: Float64Array, indentation_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return (normal_n, lateral_n); see :class:`.ContactModel`."""
        away_m, along = distance(offset_m, self.beside_m**2)
        normal_n, lateral_n = self.model.force(away_m, indentation_m)
        return normal_n, lateral_n * along

    def energy(self, offset_m: Float64Array, indentation_m: Float64Array) -> Float64Array:
        """Return the elastic energy in J; see :class:`.ContactModel`."""
        return self.model.energy(distance(offset_m, self.beside_m**2)[0], indentation_m)


def distance(past_m: Float64Array, beside_m2: float | Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return the distance from a bead beside the path, and its change along the path."""
    away_m = np.sqrt(past_m * past_m + beside_m2)
    return away_m, np.divide(past_m, away_m, out=np.zeros_like(away_m), where=away_m > 0.0)
