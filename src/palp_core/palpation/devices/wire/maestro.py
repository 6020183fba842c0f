"""Pololu Maestro's compact protocol: commands with their CRC-7, and the bits of its error word."""

from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.wire.bits import Bits

SPEED_UNIT_US_PER_S = 25.0
"""One step of speed: 0.25 us in 10 ms."""


LARGEST_INPUT = 1023
"""What an input says at 5 V."""

LONGEST_US = 4000.0
"""Longest pulse that a channel can be set to."""


class Error(Bits):
    """Bits of the error word."""

    SIGNAL = 1 << 0
    OVERRUN = 1 << 1
    BUFFER_FULL = 1 << 2
    CRC = 1 << 3
    PROTOCOL = 1 << 4
    TIMEOUT = 1 << 5
    SCRIPT_STACK = 1 << 6
    CALL_STACK = 1 << 7
    PROGRAM_COUNTER = 1 << 8


def crc7(message: bytes) -> int:
    """Return the check byte: polynomial 0x91, low bit first, from 0.

    >>> hex(crc7(bytes.fromhex("8301")))
    '0x17'
    """
    crc = 0
    for byte in message:
        crc ^= byte
        for _ in range(8):
            crc = (crc ^ 0x91) >> 1 if crc & 1 else crc >> 1
    return crc


def with_crc(message: bytes) -> bytes:
    """Return a command with its check byte."""
    return message + bytes([crc7(message)])


def _word(command: int, channel: int, value: int) -> bytes:
    check_range("maestro", "channel", channel, 0, 23)
    check_range("maestro", "value", value, 0, 0x3FFF)
    return bytes([command, channel, value & 0x7F, value >> 7])


def set_target(channel: int, quarter_us: int) -> bytes:
    """Return the command for a pulse length; 0 stops the pulses."""
    return _word(0x84, channel, quarter_us)


def set_speed(channel: int, steps: int) -> bytes:
    """Return the command for a speed limit; 0 lifts it."""
    return _word(0x87, channel, steps)


def get_position(channel: int) -> bytes:
    """Return the question for a channel's pulse length or, of an input, its voltage."""
    check_range("maestro", "channel", channel, 0, 23)
    return bytes([0x90, channel])


def get_errors() -> bytes:
    """Return the question for the error word, which the answer clears."""
    return b"\xa1"
