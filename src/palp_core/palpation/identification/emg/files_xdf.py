"""The Extensible Data Format, XDF, as LabRecorder writes it of LSL streams; pyxdf reads it.

pyxdf puts all streams on one clock and takes the jitter off the time stamps. What it does not do is done
here: what follows the last whole chunk is left out and noted, an outlet that restarted is one recording, and
a clock that went back is noted.
"""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.counted import counted
from palp_core.errors import PalpError
from palp_core.extras import install_line
from palp_core.foreign import catch_foreign
from palp_core.palpation.identification.emg.files import (
    LARGEST_BYTES,
    Column,
    EmgFile,
    plain_unit,
)
from palp_core.units import Float64Array

_MAGIC = b"XDF:"
_LENGTHS = (1, 4, 8)  # bytes that the length of a chunk may take
_BREAK_S = 0.5  # a longer pause of the time stamps is a gap; what is shorter may be jitter


@dataclass(frozen=True, eq=False)
class _Stream:
    """A stream of numbers: its outlet's name, type, rate, labels and units; samples, shape (channels, n)."""

    name: str
    kind: str
    rate_hz: float
    labels: list[str]
    units: list[str]
    samples: Float64Array
    times_s: Float64Array

    def __str__(self) -> str:
        rate = f"{self.rate_hz:g} Hz" if self.rate_hz > 0.0 else "no rate"
        return f"'{self.name}' ({self.kind or 'no type'}, {counted(len(self.labels), 'channel')}, {rate})"


def read_xdf(path: Path) -> EmgFile:
    """Read the streams of EMG, or where none is of that type all that have a rate; each channel is a column.

    Raises:
        PalpError: It is no XDF file, has no EMG, or EMG without a rate, or pyxdf is not installed.
    """
    data, notes = _whole_chunks(path)
    try:
        import pyxdf
    except ImportError as error:
        raise PalpError(f"{path}: XDF needs pyxdf; install it with: {install_line('emg')}") from error
    with catch_foreign(f"{path}: not a readable XDF file", PalpError):
        found, _ = pyxdf.load_xdf(
            io.BytesIO(data), jitter_break_threshold_seconds=_BREAK_S, jitter_break_threshold_samples=1
        )
        streams = [_stream(one) for one in found if one["info"]["channel_format"][0] != "string"]
    chosen = [one for one in streams if one.kind.lower() == "emg"]
    if not chosen:
        chosen = [one for one in streams if one.rate_hz > 0.0 and one.times_s.size]
        notes.append("no stream is of type EMG")
    has = ", ".join(map(str, streams)) or "no stream of numbers"
    if not chosen:
        raise PalpError(f"{path}: has no stream of type EMG; it has: {has}")
    for one in chosen:
        if one.rate_hz <= 0.0:
            raise PalpError(f"{path}: the stream {one} is sampled irregularly; EMG needs one rate")
    sampled = [one for one in chosen if one.times_s.size]
    if not sampled:
        raise PalpError(f"{path}: the stream {chosen[0]} has no sample: cut off, or never sent")
    columns = []
    joined = list(_joined([_forward(one, notes) for one in sampled], notes))
    for one in joined:
        before = f"{one.name}: " if len(joined) > 1 else ""
        for label, unit, row in zip(one.labels, one.units, one.samples, strict=True):
            columns.append(Column(before + label, row, unit, one.rate_hz, one.times_s))
    return EmgFile(
        path, "XDF", tuple(columns), notes=tuple(notes), rate_from="the nominal rate of the stream"
    )


def _whole_chunks(path: Path) -> tuple[bytes, list[str]]:
    """Return the file up to its last whole chunk, and a note where more follows."""
    data = path.read_bytes()
    if data[:2] == b"\x1f\x8b":
        try:
            with gzip.open(io.BytesIO(data)) as packed:
                data = packed.read(LARGEST_BYTES + 1)
        except (OSError, EOFError, zlib.error) as error:
            raise PalpError(f"{path}: a packed XDF file that is cut or damaged: {error}") from error
        if len(data) > LARGEST_BYTES:
            raise PalpError(f"{path}: unpacks to more than {LARGEST_BYTES >> 30} GiB")
    if data[: len(_MAGIC)] != _MAGIC:
        raise PalpError(f"{path}: not an XDF file; its first bytes are {data[:4]!r}")
    end = len(_MAGIC)
    for after in _chunk_ends(data):
        end = after
    if end == len(data):
        return data, []
    left = len(data) - end
    return data[:end], [f"cut or damaged after {end} bytes: the {left} bytes that follow are left out"]


def _chunk_ends(data: bytes) -> Iterator[int]:
    """Yield where each whole chunk ends; a chunk is its length's length, its length, and its content."""
    at = len(_MAGIC)
    while at < len(data) and data[at] in _LENGTHS:
        begin = at + 1 + data[at]
        at = begin + int.from_bytes(data[at + 1 : begin], "little")
        if begin > len(data) or at > len(data) or at < begin + 2:
            return
        yield at


def _stream(one: dict[str, Any]) -> _Stream:
    info = one["info"]
    count = int(info["channel_count"][0])
    description = (info.get("desc") or [None])[0] or {}
    entries = ((description.get("channels") or [None])[0] or {}).get("channel") or []
    entries += [{}] * (count - len(entries))
    return _Stream(
        name=info["name"][0] or "",
        kind=info["type"][0] or "",
        rate_hz=float(info["nominal_srate"][0]),
        labels=[(entries[i].get("label") or [None])[0] or f"channel {i + 1}" for i in range(count)],
        units=[plain_unit((entries[i].get("unit") or [None])[0] or "") for i in range(count)],
        samples=np.asarray(one["time_series"], dtype=np.float64).reshape(len(one["time_stamps"]), count).T,
        times_s=np.asarray(one["time_stamps"], dtype=np.float64),
    )


def _forward(stream: _Stream, notes: list[str]) -> _Stream:
    """Return a stream whose times go forward: after a clock that went back, samples follow without a gap."""
    times_s = stream.times_s.copy()
    for at in np.flatnonzero(np.diff(times_s) < 0.0) + 1:
        back_s = times_s[at - 1] - times_s[at]
        notes.append(
            f"the clock of stream '{stream.name}' goes back by {back_s:.4g} s at sample {at}: what follows "
            "counts as recorded right after"
        )
        times_s[at:] += back_s + 1.0 / stream.rate_hz
    return replace(stream, times_s=times_s)


def _joined(streams: list[_Stream], notes: list[str]) -> Iterator[_Stream]:
    """Yield the streams, those of an outlet that restarted as one with a gap."""
    before: dict[tuple[object, ...], _Stream] = {}
    for number, one in enumerate(streams):
        key = (one.name, one.kind, one.rate_hz, *one.labels, *one.units)
        first = before.get(key)
        if first is None:
            before[key] = one
        elif first.times_s[-1] < one.times_s[0]:
            gap_s = float(one.times_s[0] - first.times_s[-1])
            notes.append(
                f"the outlet of stream '{one.name}' restarted: one recording with a gap of {gap_s:.4g} s"
            )
            before[key] = replace(
                first,
                samples=np.concatenate([first.samples, one.samples], axis=1),
                times_s=np.concatenate([first.times_s, one.times_s]),
            )
        else:
            before[*key, number] = one
    yield from before.values()
