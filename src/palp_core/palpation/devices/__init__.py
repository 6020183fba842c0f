"""Devices of the palpation rig: what they can do, and what stands behind each name."""

from palp_core.palpation.devices.protocols import (
    EmgBlock,
    EmgSource,
    RingDevice,
    RingReading,
    StageDevice,
    StageReading,
    SweepTimes,
    TorqueBlock,
    TorqueSensor,
)
from palp_core.palpation.devices.registry import known_devices, open_device

__all__ = [
    "EmgBlock",
    "EmgSource",
    "RingDevice",
    "RingReading",
    "StageDevice",
    "StageReading",
    "SweepTimes",
    "TorqueBlock",
    "TorqueSensor",
    "known_devices",
    "open_device",
]
