"""ATI NETCANOEM on CAN: operation codes, status bits and the arithmetic from gauges to forces."""

import struct
from enum import IntEnum

from palp_core.palpation.devices.wire.bits import Bits

_POUND_N, _INCH_M = 4.4482216152605, 0.0254
FORCE_UNIT_N = {1: _POUND_N, 2: 1.0, 3: 1e3 * _POUND_N, 4: 1e3, 5: 9.80665, 6: 9.80665e-3}
TORQUE_UNIT_N_M = {
    1: _POUND_N * _INCH_M,
    2: _POUND_N * 12.0 * _INCH_M,
    3: 1.0,
    4: 1e-3,
    5: 9.80665e-2,
    6: 1e3,
}
_FIRST, _SECOND = struct.Struct(">H3h").unpack, struct.Struct(">3h").unpack
SATURATED = (-32768, 32767)
"""A gauge at either end of its range."""


class Operation(IntEnum):
    """Low four bits of an identifier."""

    READ_GAUGES = 0x0
    MATRIX_ROW = 0x2
    SERIAL_NUMBER = 0x5
    SET_CALIBRATION = 0x6
    COUNTS_PER_UNIT = 0x7
    UNITS = 0x8
    RESET = 0xC
    FIRMWARE = 0xF


class SensorStatus(Bits):
    """Bits of the status word."""

    WATCHDOG_RESET = 1 << 0
    DAC_HIGH = 1 << 1
    DAC_LOW = 1 << 2
    ANALOG_GROUND = 1 << 3
    SUPPLY_HIGH = 1 << 4
    SUPPLY_LOW = 1 << 5
    BAD_CALIBRATION = 1 << 6
    EEPROM = 1 << 7
    CONFIGURATION = 1 << 8
    TEMPERATURE_HIGH = 1 << 11
    TEMPERATURE_LOW = 1 << 12
    CAN_ERROR = 1 << 14
    ANY_ERROR = 1 << 15


CRITICAL = 0x18FE
"""Bits that make the data invalid: supply, ground, converter, calibration, memory, temperature."""


_BAD = int(CRITICAL | SensorStatus.ANY_ERROR)


def is_bad(status: int) -> bool:
    """Return whether a status word says that its data must not be used."""
    return status & _BAD != 0


def is_saturated(values: tuple[int, ...]) -> bool:
    """Return whether any gauge is at the end of its range."""
    return SATURATED[0] in values or SATURATED[1] in values


def gauges(first: bytes, second: bytes) -> tuple[int, tuple[int, ...]]:
    """Return the status word and gauges 0 to 5 of a pair of frames."""
    status, g0, g2, g4 = _FIRST(first)
    g1, g3, g5 = _SECOND(second)
    return status, (g0, g1, g2, g3, g4, g5)
