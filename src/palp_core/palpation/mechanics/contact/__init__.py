"""Contact rungs, each in a file of its own; importing this package declares them all in the register."""

from palp_core.methods import declare_task
from palp_core.palpation.mechanics.contact.l0 import Bump, FittedBump, fit_bump
from palp_core.palpation.mechanics.contact.l2 import LayeredHertz
from palp_core.palpation.mechanics.contact.l4 import HarmonicContact
from palp_core.palpation.mechanics.contact.l5 import FiniteStrainContact
from palp_core.palpation.mechanics.contact.model import ContactModel

declare_task(
    "contact",
    "With what force does the gel answer a ball in it?",
    per="set-up and a sweep of 3000 positions, nothing cached",
    output="peak",
    tolerance=0.02,
)

__all__ = [
    "Bump",
    "ContactModel",
    "FiniteStrainContact",
    "FittedBump",
    "HarmonicContact",
    "LayeredHertz",
    "fit_bump",
]
