"""Backyard Brains' SpikerShield: frames of 10-bit samples that mark their first byte."""

import re

import numpy as np

from palp_core.units import Float64Array

BAUD = 230400
_ESCAPE = re.compile(rb"\xff\xff\x01\x01\x80\xff.*?\xff\xff\x01\x01\x81\xff", re.DOTALL)
_ESCAPE_BEGIN = b"\xff\xff\x01\x01\x80\xff"
_LONGEST_MESSAGE = 256  # bytes (assumed): a mark whose end does not come by then is none


def configuration(total_rate_hz: int, channel_count: int) -> bytes:
    """Return the command that sets the sum of the channels' rates, and their number."""
    return f"conf s:{total_rate_hz};c:{channel_count};\n".encode("ascii")


class Decoder:
    """Turn bytes into samples; what is no frame is dropped and counted.

    A frame is two bytes per channel, v >> 7 and v & 0x7F; the very first has bit 7 set, all others not.
    """

    def __init__(self, channel_count: int) -> None:
        self._frame = 2 * channel_count
        self._rest = b""
        self.dropped_count = 0

    def feed(self, data: bytes) -> tuple[Float64Array, bool]:
        """Return the samples that are complete now, shape (n, channels), and whether bytes were dropped."""
        text, dropped = _ESCAPE.sub(b"", self._rest + data), 0
        held = text.find(_ESCAPE_BEGIN)
        if held >= 0 and len(text) - held > _LONGEST_MESSAGE:
            text, dropped = text.replace(_ESCAPE_BEGIN, b"", 1), len(_ESCAPE_BEGIN)
            held = text.find(_ESCAPE_BEGIN)
        if held < 0:
            held = len(text) - _begun(text)
        array = np.frombuffer(text[:held], dtype=np.uint8)
        starts = np.flatnonzero(array & 0x80)
        ends = np.append(starts[1:], len(array))
        whole = ends - starts >= self._frame
        good = starts[whole]
        kept = len(good) * self._frame
        tail = len(array) - int(starts[-1]) if len(starts) and not whole[-1] else 0
        self._rest = text[held - tail :]
        dropped += len(array) - kept - tail
        self.dropped_count += dropped
        frames = (
            array[good[:, None] + np.arange(self._frame)]
            if len(good)
            else np.empty((0, self._frame), np.uint8)
        )
        values = (frames[:, 0::2].astype(np.float64) % 128.0) * 128.0 + frames[:, 1::2]
        return values, dropped > 0


def _begun(text: bytes) -> int:
    """Return how many bytes at the end of a text may be the beginning of an escape mark."""
    lengths = range(len(_ESCAPE_BEGIN) - 1, 0, -1)
    return next((n for n in lengths if text.endswith(_ESCAPE_BEGIN[:n])), 0)
