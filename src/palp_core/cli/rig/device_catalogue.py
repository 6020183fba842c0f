"""The devices that have a driver, in words."""

import inspect
from collections.abc import Sequence
from dataclasses import dataclass

from palp_core.errors import DeviceError
from palp_core.palpation.devices.registry import back_end, drivers, kind_of
from palp_core.published import DEVICES, published


@dataclass(frozen=True)
class DeviceEntry:
    """A device: its kind, name, link in words, and the options of its driver with their defaults as text."""

    kind: str
    name: str
    link: str
    options: dict[str, str]


def device_entries(names: Sequence[str] = ()) -> list[DeviceEntry]:
    """Return every device that has a driver, by kind and name, or those named."""
    if names:
        return [_entry(kind_of(name), name) for name in names]
    return [_entry_or_error(kind, name) for kind, name in drivers()]


def _entry(kind: str, name: str) -> DeviceEntry:
    return DeviceEntry(kind, name, getattr(back_end(kind, name), "LINK", "its own"), _options(kind, name))


def _entry_or_error(kind: str, name: str) -> DeviceEntry:
    """Return a device; of one whose package cannot be imported the error is in place of its link."""
    try:
        return _entry(kind, name)
    except DeviceError as error:
        if published(DEVICES)[f"{kind}.{name}"].startswith("palp_core."):  # an extra is not installed
            raise
        return DeviceEntry(kind, name, str(error), {})


def _options(kind: str, name: str) -> dict[str, str]:
    """Return the options of a driver with their defaults as text."""
    parameters = inspect.signature(back_end(kind, name)).parameters
    return {
        option: "" if parameter.default is parameter.empty else str(parameter.default)
        for option, parameter in parameters.items()
    }
