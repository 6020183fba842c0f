"""The devices that have a driver, in words."""

import inspect
from collections.abc import Sequence
from dataclasses import dataclass

from palp_core.palpation.devices.registry import back_end, drivers, kind_of


@dataclass(frozen=True)
class DeviceEntry:
    """A device: its kind, name, link in words, and the options of its driver with their defaults as text."""

    kind: str
    name: str
    link: str
    options: dict[str, str]


def device_entries(names: Sequence[str] = ()) -> list[DeviceEntry]:
    """Return every device that has a driver, in the order of the registry, or those named.

    Raises:
        DeviceError: There is no such device.
    """
    found = [(kind_of(name), name) for name in names] or drivers()
    return [
        DeviceEntry(kind, name, getattr(back_end(kind, name), "LINK", "its own"), _options(kind, name))
        for kind, name in found
    ]


def _options(kind: str, name: str) -> dict[str, str]:
    """Return the options of a driver with their defaults as text."""
    parameters = inspect.signature(back_end(kind, name)).parameters
    return {
        option: "" if parameter.default is parameter.empty else str(parameter.default)
        for option, parameter in parameters.items()
    }
