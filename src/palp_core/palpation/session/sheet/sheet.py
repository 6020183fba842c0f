"""What a session's sheet says."""

import msgspec

NONE = "none"
"""What stands for a subject or an approval that there is none of."""


class PhantomEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A phantom as it was made."""

    id: str  # what is written on it
    batch: str  # of its silicone
    cured: str  # day on which it was cured, ``2026-03-01``
    cure_temperature_c: float  # at which it was cured


class SensorEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The torque sensor."""

    serial: str
    bias_n_m: float  # what it reads with nothing on it


class SessionSheet(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Who, on whom, on what, by which approval.

    Attributes:
        lab: Where.
        operator: Who ran it: initials or a code.
        subject: Code of who was measured, never a name; ``none`` where nobody was.
        ethics: Id of the approval; ``none`` where nobody was measured.
        phantoms: By code, as the launch file's phantoms have it.
        sensor: The torque sensor; None in simulation.
        note: Anything else.
        software: Versions, as palp found them.
        simulated: Whether the touch was computed, as palp found it.
        began: Local time of the launch, as palp found it.
    """

    lab: str
    operator: str
    subject: str = NONE
    ethics: str = NONE
    phantoms: dict[str, PhantomEntry] = {}
    sensor: SensorEntry | None = None
    note: str = ""
    software: dict[str, str] = {}
    simulated: bool = False
    began: str = ""


BY_PALP = ("software", "simulated", "began")
"""What palp fills in at launch, whatever the file says."""

SIMULATED = SessionSheet(lab="simulation", operator=NONE, simulated=True)
"""The sheet of a simulated session that was given none."""
