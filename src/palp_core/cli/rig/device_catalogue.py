"""The devices that have a driver, in words."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields

from palp_core.errors import DeviceError
from palp_core.palpation.devices.registry import back_end, known_devices

ORDER = ("aerotech", "maestro", "ati", "netft", "noraxon", "lsl", "spikershield")
_LINKS = {
    "aerotech": "Aerotech ASCII (Ensemble, Soloist): serial or TCP 8000",
    "maestro": "Pololu Maestro with CRC, driving an L12-I: serial",
    "ati": "ATI NETCANOEM: CAN, any interface of python-can",
    "netft": "ATI Net F/T: UDP 49152",
    "noraxon": "Noraxon MR3: HTTP 9220",
    "lsl": "Lab Streaming Layer: an inlet of type EMG (pip install 'palp[lsl]')",
    "spikershield": "Backyard Brains' Muscle SpikerShield: serial at 230400",
}


@dataclass(frozen=True)
class DeviceEntry:
    """A device: its kind, name, link in words, and the options of its driver with their defaults as text."""

    kind: str
    name: str
    link: str
    options: dict[str, str]


def kind_of(name: str) -> str:
    """Return the kind of a device.

    Raises:
        DeviceError: There is no such device.
    """
    for kind in ("stage", "ring", "torque", "emg"):
        if name in known_devices(kind) and name != "sim":
            return kind
    raise DeviceError(f"no device '{name}'; known: {', '.join(ORDER)}")


def device_entries() -> list[DeviceEntry]:
    """Return every device that has a driver, in the order of the documentation."""
    found = []
    for name in ORDER:
        kind = kind_of(name)
        options = {
            field.name: "" if field.default is MISSING else str(field.default)
            for field in fields(back_end(kind, name))
            if field.init
        }
        found.append(DeviceEntry(kind, name, _LINKS[name], options))
    return found
