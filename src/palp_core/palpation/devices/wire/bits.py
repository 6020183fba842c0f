"""Status words of devices: their bits in plain English."""

from enum import IntFlag


class Bits(IntFlag):
    """A word of flags, of which the documents may name only some."""

    @property
    def words(self) -> str:
        """Names of the set bits; one without a name by its number."""
        known = {bit.value: bit.name.lower().replace("_", " ") for bit in self if bit.name}
        return ", ".join(known.get(1 << k, f"bit {k}") for k in range(32) if self & 1 << k) or "none"
