"""Aerotech's ASCII commands: replies, parameter numbers and status bits (Ensemble, Soloist)."""

from collections.abc import Iterable
from enum import IntFlag
from typing import TypeVar

from palp_core.errors import DeviceError
from palp_core.palpation.devices.wire.bits import Bits
from palp_core.units import Float64Array

P = TypeVar("P", float, Float64Array)

END = b"\n"
ACKNOWLEDGED = b"%"
REPLIES = {b"%": "done", b"!": "invalid command", b"#": "could not be executed", b"$": "timed out"}


class Parameter:
    """Numbers of the controller's parameters."""

    SOFT_LIMIT_LOW = 37
    SOFT_LIMIT_HIGH = 38
    DEFAULT_RAMP_RATE = 72
    ABORT_DECEL_RATE = 73


class AxisStatus(IntFlag):
    """Bits of AXISSTATUS; 22 to 31 are raw input levels, blind to their polarity."""

    ENABLED = 1 << 0
    HOMED = 1 << 1
    IN_POSITION = 1 << 2
    MOVING = 1 << 3
    ACCELERATING = 1 << 4
    DECELERATING = 1 << 5
    DIRECTION = 1 << 9
    HOMING = 1 << 14
    ESTOP_INPUT = 1 << 31


class Plane(IntFlag):
    """Bits of PLANESTATUS."""

    MOVING = 1 << 0


class Fault(Bits):
    """Bits of AXISFAULT."""

    POSITION_ERROR = 1 << 0
    OVER_CURRENT = 1 << 1
    CW_END_OF_TRAVEL = 1 << 2
    CCW_END_OF_TRAVEL = 1 << 3
    CW_SOFT_LIMIT = 1 << 4
    CCW_SOFT_LIMIT = 1 << 5
    AMPLIFIER = 1 << 6
    POSITION_FEEDBACK = 1 << 7
    VELOCITY_FEEDBACK = 1 << 8
    HALL = 1 << 9
    MAX_VELOCITY = 1 << 10
    E_STOP = 1 << 11
    VELOCITY_ERROR = 1 << 12
    EXTERNAL = 1 << 15
    MOTOR_TEMPERATURE = 1 << 17
    AMPLIFIER_TEMPERATURE = 1 << 18
    ENCODER = 1 << 19
    COMMUNICATION_LOST = 1 << 20
    FEEDBACK_SCALING = 1 << 23
    MARKER_SEARCH = 1 << 24
    VOLTAGE_CLAMP = 1 << 27
    POWER_SUPPLY = 1 << 28
    INTERNAL = 1 << 30

    LIMITS = CW_END_OF_TRAVEL | CCW_END_OF_TRAVEL | CW_SOFT_LIMIT | CCW_SOFT_LIMIT


def command(text: str) -> bytes:
    """Return a command as bytes."""
    return text.encode("ascii") + END


def each(verb: str, axes: Iterable[str]) -> bytes:
    """Return a command for every axis, as one write."""
    return b"".join(command(f"{verb} {axis}") for axis in axes)


def move(axis: str, position: float, speed: float) -> bytes:
    """Return an absolute move at a speed, both in user units."""
    return command(f"MOVEABS {axis} {position:.3f} {axis}F {speed:.3f}")


def place_m(controller_mm: P, origin_m: float, sign: int) -> P:
    """Return a controller's position in the stage's coordinates, of this origin and direction."""
    return sign * (controller_mm * 1e-3 - origin_m)


def mask(value: bytes) -> int:
    """Return the bits of a reply's value: a signed 32-bit decimal number."""
    try:
        number = int(value)
    except ValueError as error:
        raise DeviceError(f"aerotech: {value!r} is not a decimal number") from error
    if not -(1 << 31) <= number < 1 << 32:
        raise DeviceError(f"aerotech: {number} does not fit 32 bits")
    return number & 0xFFFFFFFF
