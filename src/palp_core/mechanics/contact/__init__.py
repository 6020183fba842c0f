"""Contact rungs, each in a file of its own; importing this package declares them all in the register."""

from palp_core.mechanics.contact.l2 import LayeredHertz
from palp_core.mechanics.contact.model import ContactModel

__all__ = ["ContactModel", "LayeredHertz"]
