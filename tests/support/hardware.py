"""The devices of ``--hardware CONFIG``: which they are, where, and how far the contract may move them."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest
import yaml

from palp_core.errors import DeviceError
from palp_core.palpation.devices import known_devices
from palp_core.palpation.devices.limits import TravelLimits

__all__ = ["HARDWARE", "Hardware", "read_hardware"]

STAGE_M = (-0.021, 0.021)
"""What the contract uses of the sweep's axis: it returns to -20 mm and sweeps 2 mm to either side of 0."""
RING_M = (0.0, 0.010)
"""What it uses of the ring."""
SPEEDS_M_PER_S = {"sweep_speed_m_per_s": 0.020, "return_speed_m_per_s": 0.050, "lift_speed_m_per_s": 0.020}


class Hardware(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One entry: the device's name, the options of its driver, and for what moves how far it may."""

    device: str
    options: dict[str, Any] = {}
    travel: dict[str, Any] = {}


HARDWARE = pytest.StashKey[dict[str, Hardware]]()
"""Where pytest's configuration keeps the devices of ``--hardware`` by kind."""


def read_hardware(path: Path) -> dict[str, Hardware]:
    """Return the entries of a YAML or TOML file by kind, with their limits among the driver's options.

    Raises:
        DeviceError: The file cannot be read, names what there is not, or does not say how far stage or ring
            may move, or not as far as the contract does.
    """
    try:
        text = path.read_text(encoding="utf-8")
        tree = tomllib.loads(text) if path.suffix == ".toml" else yaml.safe_load(text)
        found = msgspec.convert(tree, dict[str, Hardware])
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise DeviceError(f"{path}: no list of devices: {error}; see docs/hardware.yaml") from error
    return {kind: _checked(f"{path}: {kind}", kind, entry) for kind, entry in found.items()}


def _checked(where: str, kind: str, entry: Hardware) -> Hardware:
    names = [name for name in known_devices(kind) if name != "sim"]
    if entry.device not in names:
        raise DeviceError(f"{where}: no device '{entry.device}'; known: {', '.join(names)}")
    if kind in ("torque", "emg"):
        return entry
    if not entry.travel:
        raise DeviceError(f"{where}: it would move, and 'travel' does not say how far it may")
    if kind == "ring":
        _covers(where, "ring_m", entry.travel.get("ring_m"), RING_M)
        return entry
    try:
        limits = msgspec.convert(entry.travel, TravelLimits)
    except msgspec.ValidationError as error:
        raise DeviceError(f"{where}: travel: {error}") from error
    for name in ("y_m", "z_m", "speed_m_per_s"):
        if name not in entry.travel:
            raise DeviceError(f"{where}: it would move, and 'travel' does not give {name}")
    _covers(where, "y_m", limits.y_m, STAGE_M)
    slow = {name: min(speed, limits.speed_m_per_s) for name, speed in SPEEDS_M_PER_S.items()}
    return Hardware(entry.device, {**slow, **entry.options, "limits": limits}, entry.travel)


def _covers(where: str, name: str, window: Any, needed: tuple[float, float]) -> None:
    try:
        low, high = msgspec.convert(window, tuple[float, float])
    except msgspec.ValidationError as error:
        raise DeviceError(f"{where}: travel: {name} = {window!r} is no window: {error}") from error
    if not (low <= needed[0] and needed[1] <= high):
        raise DeviceError(
            f"{where}: travel: {name} = [{low:g}, {high:g}]; the contract moves over"
            f" [{needed[0]:g}, {needed[1]:g}] m: nothing is moved beyond what is allowed, so nothing is moved"
        )
