"""The Extensible Data Format, XDF, as LabRecorder writes it of LSL streams; pyxdf reads it.

pyxdf puts all streams on one clock and takes the jitter off the time stamps. What it does not do is done
here: what follows the last whole chunk is left out and said, and lost samples become NaN at their place.
Streams of EMG that were sampled at one rate are put side by side by their times; others are refused in words.
"""

from __future__ import annotations

import gzip
import io
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import ParseError

import numpy as np

from palp_core.counted import counted
from palp_core.errors import PalpError
from palp_core.extras import install_line
from palp_core.palpation.identification.emg.files import LARGEST_BYTES, Column, EmgFile
from palp_core.units import Float64Array

_MAGIC = b"XDF:"
_LENGTHS = (1, 4, 8)  # bytes that the length of a chunk may take
_BREAK_S = 0.5  # a longer pause of the time stamps is a gap; what is shorter may be jitter
_SLOWEST_HZ = 100.0  # EMG is not sampled more slowly
_RATE_OFF = 0.05  # a stream whose samples come at another rate than it says is not what it says
_MOST_LOST = 10  # grid over samples; beyond it the samples are not one recording
_UNITS = {"microvolt": "uV", "millivolt": "mV", "nanovolt": "nV", "volt": "V"}
_BROKEN = (ValueError, KeyError, IndexError, TypeError, AttributeError, EOFError, ZeroDivisionError)


@dataclass(frozen=True, eq=False)
class _Stream:
    """A stream of numbers.

    Attributes:
        name: As its outlet had it.
        kind: What its outlet said that it carries, ``EMG`` say.
        rate_hz: As it says; 0 where it has none.
        measured_hz: As it came.
        labels: Of its channels.
        units: Of its channels.
        samples: Shape (channels, n).
        times_s: Time stamps, shape (n,).
        segments: Stretches [begin, end) of samples without a gap.
    """

    name: str
    kind: str
    rate_hz: float
    measured_hz: float
    labels: list[str]
    units: list[str]
    samples: Float64Array
    times_s: Float64Array
    segments: list[tuple[int, int]]

    def __str__(self) -> str:
        rate = f"{self.rate_hz:g} Hz" if self.rate_hz > 0.0 else "no rate"
        return f"'{self.name}' ({self.kind or 'no type'}, {len(self.labels)} channels, {rate})"


def read_xdf(path: Path) -> EmgFile:
    """Read the streams of EMG, each channel a column, on one grid of times; lost samples become NaN.

    Raises:
        PalpError: It is no XDF file, has no EMG, or EMG without one rate, or pyxdf is not installed.
    """
    data, notes = _whole_chunks(path)
    streams = list(_streams(path, data))
    chosen, why = _emg(path, streams)
    notes += why
    rate_hz = chosen[0].rate_hz
    begin_s = min(float(one.times_s[0]) for one in chosen)
    length = max(_places(one, begin_s)[-1] + one.segments[-1][1] - one.segments[-1][0] for one in chosen)
    if length > _MOST_LOST * max(one.times_s.size for one in chosen):
        raise PalpError(
            f"{path}: {length} samples long with gaps, of which most are missing; record it again"
        )
    columns = []
    for one in chosen:
        muscles = np.full((len(one.labels), length), np.nan)
        for place, (first, last) in zip(_places(one, begin_s), one.segments, strict=True):
            muscles[:, place : place + last - first] = one.samples[:, first:last]
        if len(one.segments) > 1:
            gaps = counted(len(one.segments) - 1, "gap, which counts", "gaps, which count")
            notes.append(f"stream '{one.name}' has {gaps} as lost samples")
        if abs(one.measured_hz / rate_hz - 1.0) > 1e-3:
            notes.append(f"stream '{one.name}' came at {one.measured_hz:.6g} Hz")
        before = f"{one.name}: " if len(chosen) > 1 else ""
        for label, unit, row in zip(one.labels, one.units, muscles, strict=True):
            columns.append(Column(before + label, row, rate_hz, unit))
    return EmgFile(path, "XDF", tuple(columns), notes=tuple(notes))


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


def _streams(path: Path, data: bytes) -> Iterator[_Stream]:
    try:
        import pyxdf
    except ImportError as error:
        raise PalpError(f"{path}: XDF needs pyxdf; install it with: {install_line('emg')}") from error
    try:
        found, _ = pyxdf.load_xdf(
            io.BytesIO(data), jitter_break_threshold_seconds=_BREAK_S, jitter_break_threshold_samples=1
        )
        for one in found:
            if one["info"]["channel_format"][0] != "string":
                yield _stream(one)
    except (*_BROKEN, OSError, struct.error, ParseError) as error:
        raise PalpError(f"{path}: damaged XDF file: {type(error).__name__}: {error}") from error


def _stream(one: dict[str, Any]) -> _Stream:
    info = one["info"]
    count = int(info["channel_count"][0])
    samples = np.asarray(one["time_series"], dtype=np.float64).reshape(len(one["time_stamps"]), count).T
    labels, units = _channels(info, count)
    return _Stream(
        name=info["name"][0] or "",
        kind=info["type"][0] or "",
        rate_hz=float(info["nominal_srate"][0]),
        measured_hz=float(info.get("effective_srate") or 0.0),
        labels=labels,
        units=units,
        samples=samples,
        times_s=np.asarray(one["time_stamps"], dtype=np.float64),
        segments=[(first, last + 1) for first, last in info.get("segments", ())],
    )


def _channels(info: dict[str, Any], count: int) -> tuple[list[str], list[str]]:
    """Return labels and units of a stream's channels; those without a label are numbered from 1."""
    description = (info.get("desc") or [None])[0] or {}
    entries = ((description.get("channels") or [None])[0] or {}).get("channel") or []
    labels, units = [], []
    for place in range(count):
        entry = entries[place] if place < len(entries) else {}
        labels.append((entry.get("label") or [None])[0] or f"channel {place + 1}")
        unit = (entry.get("unit") or [None])[0] or ""
        units.append(_UNITS.get(unit.lower().removesuffix("s"), unit))
    return labels, units


def _emg(path: Path, streams: Sequence[_Stream]) -> tuple[list[_Stream], list[str]]:
    """Return the streams that are EMG, and what is to be said of the choice.

    Raises:
        PalpError: There is none, it has no sample, or not one rate.
    """
    has = ", ".join(map(str, streams)) or "no stream of numbers"
    chosen, notes = [one for one in streams if one.kind.lower() == "emg"], []
    if not chosen:
        chosen = [one for one in streams if one.rate_hz >= _SLOWEST_HZ and one.kind.lower() != "audio"]
        if len(chosen) != 1:
            raise PalpError(f"{path}: has no stream of type EMG; it has: {has}")
        notes.append(f"no stream is of type EMG; taken: {chosen[0]}, the only one sampled as EMG is")
    for one in chosen:
        if one.times_s.size == 0:
            raise PalpError(f"{path}: the stream {one} has no sample: cut off, or never sent")
        if one.rate_hz <= 0.0:
            raise PalpError(f"{path}: the stream {one} is sampled irregularly; EMG needs one rate")
        if one.times_s.size > 1 and abs(one.measured_hz / one.rate_hz - 1.0) > _RATE_OFF:
            raise PalpError(
                f"{path}: the stream {one} came at {one.measured_hz:.4g} Hz: samples are missing all along, "
                "or its outlet states another rate than its device has"
            )
    if len({one.rate_hz for one in chosen}) > 1:
        several = ", ".join(map(str, chosen))
        raise PalpError(
            f"{path}: has several streams of EMG that differ in rate: {several}; the muscles need one: "
            "record the others to a file of their own, or resample them"
        )
    return chosen, notes


def _places(one: _Stream, begin_s: float) -> list[int]:
    """Return where each segment of a stream begins on the grid of samples; none overlaps the one before."""
    places: list[int] = []
    least = 0
    for first, last in one.segments:
        place = round((float(one.times_s[first]) - begin_s) * one.rate_hz)
        places.append(max(place, least))
        least = places[-1] + last - first
    return places
