"""Devices of the palpation rig: what they can do, and the class of each name."""

from typing import TYPE_CHECKING

from palp_core.lazy_names import lazy_names

if TYPE_CHECKING:
    from palp_core.palpation.devices.protocols import (
        EmgDevice,
        EmgSamples,
        RingDevice,
        RingReading,
        StageDevice,
        StageReading,
        SweepTimes,
        TorqueSamples,
        TorqueSensor,
    )
    from palp_core.palpation.devices.registry import known_devices, open_device

__all__ = [
    "EmgDevice",
    "EmgSamples",
    "RingDevice",
    "RingReading",
    "StageDevice",
    "StageReading",
    "SweepTimes",
    "TorqueSamples",
    "TorqueSensor",
    "known_devices",
    "open_device",
]

__getattr__, __dir__ = lazy_names(__name__)
