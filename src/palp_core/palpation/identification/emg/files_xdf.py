"""The Extensible Data Format, XDF, as LabRecorder writes it of LSL streams; pyxdf reads it.

pyxdf puts all streams on one clock. What it does not do is done here: headers are checked, what follows the
last whole chunk is left out and noted, jitter goes but no gap does, a clock that went back is noted, and an
outlet that restarted is one recording.
"""

from __future__ import annotations

import gzip
import io
import re
import zlib
from bisect import bisect
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import ParseError, fromstring

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
_LENGTHS = (1, 4, 8)  # bytes that a length or a count may take
_COUNTS = tuple(map(bytes, zip(_LENGTHS)))
_STREAM_HEADER, _SAMPLES, _CLOCK_OFFSET, _FOOTER = 2, 3, 4, 6  # kinds of chunks
_BYTES = {
    "float32": 4,
    "double64": 8,
    "int8": 1,
    "int16": 2,
    "int32": 4,
    "int64": 8,
    "string": 0,
}  # of a value
_NEEDED = {
    "name": r".+",
    "channel_count": r"[1-9]\d*",
    "nominal_srate": r"\d+(\.\d*)?([eE][+-]?\d+)?",
    "channel_format": "|".join(_BYTES),
}  # what the header of a stream states
_MEND = "record or copy it again"
_HARM = re.compile("corrupt|truncat|cannot be used|No samples")  # of what pyxdf logs
_MOST_JITTER = 8.0  # ordinary deviations of the time stamps; what stays farther off is a step
_LEVEL_S = 1.0  # for which it has to stay


@dataclass(frozen=True, eq=False)
class _Stream:
    """A stream of numbers: name, type, rate and source of its outlet; samples, shape (channels, n)."""

    name: str
    kind: str
    rate_hz: float
    source: str
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
    with catch_foreign(f"{path}: not a readable XDF file", PalpError, _MEND) as remarks:
        found, _ = pyxdf.load_xdf(io.BytesIO(data), dejitter_timestamps=False)
        streams = [_stream(one, notes) for one in found if one["info"]["channel_format"][0] != "string"]
    notes += [f"pyxdf: {remark}" for remark in remarks if _HARM.search(remark)]
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
    joined = list(_joined([_even(one, notes) for one in sampled], notes))
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
    sizes: dict[int, int] = {}  # bytes of a sample of each stream; 0: text
    damaged: list[tuple[int, int]] = []
    end = len(_MAGIC)
    for kind, first, begin, end in _chunks(data):
        number = int.from_bytes(data[begin : begin + 4], "little")
        if kind == _STREAM_HEADER:
            if number in sizes:
                raise PalpError(f"{path}: stream {number} has two headers; {_MEND}")
            sizes[number] = _sample_bytes(f"{path}: damaged header of stream {number}", data[begin + 4 : end])
        elif kind in (_SAMPLES, _CLOCK_OFFSET, _FOOTER) and not (
            number in sizes and (kind != _SAMPLES or _is_whole(data[begin + 4 : end], sizes[number]))
        ):
            damaged.append((first, end))
    notes = []
    if left := len(data) - end:
        notes.append(f"cut or damaged after {end} bytes: {counted(left, 'byte')} from there on left out")
    if damaged:
        notes.append(f"{counted(len(damaged), 'damaged chunk')} left out, the first at byte {damaged[0][0]}")
    kept = zip([0, *(stop for _, stop in damaged)], [*(first for first, _ in damaged), end], strict=True)
    return b"".join(data[first:stop] for first, stop in kept), notes


def _chunks(data: bytes) -> Iterator[tuple[int, int, int, int]]:
    """Yield kind, first byte, begin of the content and end of each whole chunk.

    A chunk is its length's length, its length, its kind, and its content.
    """
    at = len(_MAGIC)
    while at < len(data) and data[at] in _LENGTHS:
        first, begin = at, at + 1 + data[at]
        at = begin + int.from_bytes(data[first + 1 : begin], "little")
        if begin > len(data) or at > len(data) or at < begin + 2:
            return
        yield int.from_bytes(data[begin : begin + 2], "little"), first, begin + 2, at


def _is_whole(samples: bytes, size: int) -> bool:
    """Return whether a chunk has as many samples of a size as it states, each with a time or without one."""
    begin = 1 + samples[0] if samples else 0
    count = int.from_bytes(samples[1:begin], "little")
    times, rest = divmod(len(samples) - begin - count * (1 + size), 8)
    return samples[:1] in _COUNTS and (not size or (rest == 0 and 0 <= times <= count))


def _sample_bytes(place: str, xml: bytes) -> int:
    """Return the bytes of a sample by the header of its stream."""
    try:
        info = fromstring(xml.decode(errors="replace"))
    except ParseError as error:
        raise PalpError(f"{place}: {error}; {_MEND}") from error
    texts = {name: info.findtext(name) or "" for name in _NEEDED}
    for name, right in _NEEDED.items():
        if not re.fullmatch(right, texts[name]):
            raise PalpError(f"{place}: {name} is '{texts[name]}'; {_MEND}")
    return _BYTES[texts["channel_format"]] * int(texts["channel_count"])


def _stream(one: dict[str, Any], notes: list[str]) -> _Stream:
    info = one["info"]
    name, count = _text(info, "name"), int(info["channel_count"][0])
    channels = _first(_first(info, "desc"), "channels")
    entries = channels.get("channel", []) if isinstance(channels, dict) else []
    if len(entries) not in (0, count):
        notes.append(
            f"stream '{name}' has {counted(count, 'channel')}, its {len(entries)} labels are not used"
        )
        entries = []
    entries = entries or [{}] * count
    return _Stream(
        name=name,
        kind=_text(info, "type"),
        rate_hz=float(info["nominal_srate"][0]),
        source=_text(info, "source_id"),
        labels=[_text(entry, "label") or f"channel {i + 1}" for i, entry in enumerate(entries)],
        units=[plain_unit(_text(entry, "unit")) for entry in entries],
        samples=np.asarray(one["time_series"], dtype=np.float64).reshape(len(one["time_stamps"]), count).T,
        times_s=np.asarray(one["time_stamps"], dtype=np.float64),
    )


def _first(node: Any, name: str) -> Any:
    """Return the first child of a name in what pyxdf makes of XML; None where it has none."""
    return (node.get(name) or [None])[0] if isinstance(node, dict) else None


def _text(node: Any, name: str) -> str:
    found = _first(node, name)
    return found.strip() if isinstance(found, str) else ""


def _even(stream: _Stream, notes: list[str]) -> _Stream:
    """Return a stream whose times are even from step to step, and go forward.

    After a clock that went back, samples follow without a gap.
    """
    steps = _steps(stream.times_s, stream.rate_hz)
    parts = [(np.arange(one.size) - (one.size - 1) / 2.0, one) for one in np.split(stream.times_s, steps)]
    weight = sum(float(places @ places) for places, _ in parts)
    period_s = sum(float(places @ one) for places, one in parts) / weight if weight else 1.0 / stream.rate_hz
    if not period_s > 0.0:  # also where a time is no number
        return stream
    times_s = np.concatenate([one.mean() + period_s * places for places, one in parts])
    for at in steps:
        back_s = times_s[at - 1] + period_s - times_s[at]
        if back_s > 0.0:
            notes.append(
                f"the clock of stream '{stream.name}' goes back by {back_s:.3g} s at sample {at}: what "
                "follows counts as recorded right after"
            )
            times_s[at:] += back_s
    return replace(stream, times_s=times_s)


def _steps(times_s: Float64Array, rate_hz: float) -> list[int]:
    """Return the samples from which on all times are late or early, by more than jitter."""
    width = max(1, min(times_s.size // 16, round(_LEVEL_S * rate_hz)))
    lags_s = times_s[width:] - times_s[:-width]
    if not lags_s.size:
        return []
    period_s = float(np.median(lags_s)) / width
    late_s = times_s - period_s * np.arange(times_s.size)
    blocks = late_s[: late_s.size // width * width].reshape(-1, width)
    levels = np.median(blocks, axis=1)
    off_s = np.abs(blocks - levels[:, None])
    jitter_s = float(np.median(off_s) + np.median(np.abs(np.diff(levels))))
    least_s = max(0.5 * period_s, _MOST_JITTER * jitter_s)
    at_ends_s = max(least_s, 2.0 * float(np.quantile(off_s, 0.95)))  # few samples show whether it stays
    jumps_s = np.abs(np.diff(late_s))
    found: list[int] = [0, times_s.size]
    for at in (np.flatnonzero(jumps_s > least_s) + 1)[np.argsort(-jumps_s[jumps_s > least_s])].tolist():
        place = bisect(found, at)  # a larger step ends what counts as before and after
        before_s = late_s[max(found[place - 1], at - width) : at]
        after_s = late_s[at : min(found[place], at + width)]
        short = min(before_s.size, after_s.size) < width // 2
        if abs(np.median(after_s) - np.median(before_s)) > (at_ends_s if short else least_s):
            found.insert(place, at)
    return found[1:-1]


def _joined(streams: list[_Stream], notes: list[str]) -> Iterator[_Stream]:
    """Yield the streams, those of an outlet that restarted as one with a gap."""
    groups: dict[tuple[object, ...], list[_Stream]] = {}
    for one in streams:
        key = (one.name, one.kind, one.rate_hz, one.source, *one.labels, *one.units)
        groups.setdefault(key, []).append(one)
    for group in groups.values():
        parts = sorted(group, key=lambda one: float(one.times_s[0]))
        gaps_s = [float(after.times_s[0] - before.times_s[-1]) for before, after in pairwise(parts)]
        if not all(gap_s > 0.0 for gap_s in gaps_s):  # outlets of one name, side by side
            yield from group
            continue
        ends = np.cumsum([one.times_s.size for one in parts])
        notes += [
            f"the outlet of stream '{parts[0].name}' restarted: one recording with a gap of {gap_s:.4g} s at "
            f"sample {end}"
            for gap_s, end in zip(gaps_s, ends, strict=False)
        ]
        yield replace(
            parts[0],
            samples=np.concatenate([one.samples for one in parts], axis=1),
            times_s=np.concatenate([one.times_s for one in parts]),
        )
