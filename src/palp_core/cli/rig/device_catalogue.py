"""The devices that have a driver, in words."""

from dataclasses import MISSING, dataclass, fields

from palp_core.errors import DeviceError
from palp_core.palpation.devices.registry import back_end, drivers


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
    kinds = {known: kind for kind, known in drivers()}
    if name not in kinds:
        raise DeviceError(f"no device '{name}'; known: {', '.join(kinds)}")
    return kinds[name]


def device_entries() -> list[DeviceEntry]:
    """Return every device that has a driver, in the order of the registry."""
    return [
        DeviceEntry(kind, name, back_end(kind, name).LINK, _options(kind, name)) for kind, name in drivers()
    ]


def _options(kind: str, name: str) -> dict[str, str]:
    """Return the options of a driver with their defaults as text."""
    return {
        field.name: "" if field.default is MISSING else str(field.default)
        for field in fields(back_end(kind, name))
        if field.init
    }
