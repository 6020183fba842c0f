"""Contact rungs, each in a file of its own."""

from typing import TYPE_CHECKING

from palp_core.lazy_names import lazy_names

if TYPE_CHECKING:
    from palp_core.palpation.mechanics.contact.l0 import Bump, FittedBump, fit_bump
    from palp_core.palpation.mechanics.contact.l2 import LayeredHertz
    from palp_core.palpation.mechanics.contact.l4 import HarmonicContact
    from palp_core.palpation.mechanics.contact.l5 import FiniteStrainContact
    from palp_core.palpation.mechanics.contact.model import ContactModel

__all__ = [
    "Bump",
    "ContactModel",
    "FiniteStrainContact",
    "FittedBump",
    "HarmonicContact",
    "LayeredHertz",
    "fit_bump",
]

__getattr__, __dir__ = lazy_names(__name__)
