"""XDF files, written chunk by chunk as its specification says and LabRecorder does."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

_CODES = {"float32": "f", "double64": "d", "int16": "h"}


@dataclasses.dataclass(frozen=True)
class XdfStream:
    """A stream: ``samples`` has a row per sample, ``times_s`` a time for each."""

    name: str
    kind: str
    rate_hz: float
    samples: np.ndarray[Any, Any] | Sequence[str]
    times_s: Sequence[float]
    labels: Sequence[str] = ()
    unit: str = "microvolts"
    form: str = "float32"

    def header(self) -> str:
        """Return the XML of its header."""
        count = np.shape(self.samples)[1] if self.form != "string" else 1
        channels = "".join(
            f"<channel><label>{one}</label><unit>{self.unit}</unit></channel>" for one in self.labels
        )
        desc = f"<desc><channels>{channels}</channels></desc>" if channels else "<desc/>"
        return (
            f'<?xml version="1.0"?><info><name>{self.name}</name><type>{self.kind}</type>'
            f"<channel_count>{count}</channel_count><nominal_srate>{self.rate_hz!r}</nominal_srate>"
            f"<channel_format>{self.form}</channel_format><created_at>1.0</created_at>{desc}</info>"
        )


def chunk(tag: int, content: bytes) -> bytes:
    """Return a chunk, its length in as many bytes as the format has for it."""
    size = len(content) + 2
    width, code = (1, "<B") if size < 256 else (4, "<I")
    return bytes([width]) + struct.pack(code, size) + struct.pack("<H", tag) + content


def count_of(number: int) -> bytes:
    return b"\x04" + struct.pack("<I", number)


def xdf(*streams: XdfStream, per_chunk: int = 50, offset_s: float = 0.0) -> bytes:
    """Return a file of streams, whose chunks take turns; each has a clock that differs by ``offset_s``."""
    found = b"XDF:" + chunk(1, b'<?xml version="1.0"?><info><version>1.0</version></info>')
    for number, stream in enumerate(streams, 1):
        found += chunk(2, struct.pack("<I", number) + stream.header().encode())
    longest = max((len(stream.times_s) for stream in streams), default=0)
    for first in range(0, longest, per_chunk):
        for number, stream in enumerate(streams, 1):
            times_s = stream.times_s[first : first + per_chunk]
            if not len(times_s):
                continue
            body = struct.pack("<I", number) + count_of(len(times_s))
            for time_s, sample in zip(times_s, stream.samples[first : first + per_chunk], strict=True):
                body += b"\x08" + struct.pack("<d", time_s - offset_s)
                if stream.form == "string":
                    text = str(sample).encode()
                    body += b"\x01" + bytes([len(text)]) + text
                else:
                    body += struct.pack(f"<{len(sample)}{_CODES[stream.form]}", *sample)
            found += chunk(3, body)
            if offset_s:
                found += chunk(4, struct.pack("<Idd", number, times_s[0] - offset_s, offset_s))
        found += chunk(5, bytes.fromhex("43a546dccbf5410fb30ed5467383cbe4"))
    for number, stream in enumerate(streams, 1):
        footer = f'<?xml version="1.0"?><info><sample_count>{len(stream.times_s)}</sample_count></info>'
        found += chunk(6, struct.pack("<I", number) + footer.encode())
    return found
