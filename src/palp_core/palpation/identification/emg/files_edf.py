"""European Data Format, EDF and EDF+ (16 bit), and BioSemi's BDF and BDF+ (24 bit).

The layout is the one published by Kemp et al., Electroenceph. clin. Neurophysiol. 82 (1992) 391, and Kemp and
Olivan, Clin. Neurophysiol. 114 (2003) 1755: a header of text, then records of interleaved blocks of integers.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PalpError
from palp_core.palpation.identification.emg.files import Column, EmgFile
from palp_core.units import Float64Array

_LEAST_PADDING = 8  # samples; EMG does not stay that long at one value
_MAIN = 256  # bytes of the main header, and of the header of each signal
_WIDTHS = (16, 80, 8, 8, 8, 8, 8, 80, 8, 32)  # label, transducer, unit, ranges (4), filter, samples, reserved
_ANNOTATIONS = ("EDF Annotations", "BDF Annotations")
_TRIGGERS = "Status"  # BioSemi's channel of bits


@dataclass(frozen=True)
class _Signal:
    label: str
    unit: str
    physical: tuple[float, float]
    digital: tuple[float, float]
    per_record: int


def read_edf(path: Path) -> EmgFile:
    """Read every signal, scaled to its physical unit; gaps of a discontinuous file become NaN.

    Raises:
        PalpError: The header is not that of EDF or BDF, or no whole record follows it.
    """
    data = path.read_bytes()
    wide = data[:1] == b"\xff"
    if not wide and data[:8].strip() != b"0":
        raise PalpError(f"{path}: not an EDF or BDF file; its first bytes are {data[:8]!r}")
    try:
        signals, record_count, record_s, discontinuous, begin = _header(data)
    except (ValueError, IndexError) as error:
        raise PalpError(f"{path}: damaged EDF header: {error}") from error
    bytes_each = 3 if wide else 2
    record_size = bytes_each * sum(signal.per_record for signal in signals)
    there = (len(data) - begin) // record_size if record_size else 0
    notes = []
    if 0 <= record_count != there:
        notes.append(f"the header promises {record_count} records, the file has {there}")
    if there < 1 or record_s <= 0.0:
        raise PalpError(f"{path}: no whole record of positive duration after the header")
    raw = np.frombuffer(data, np.uint8, there * record_size, begin).reshape(there, record_size)
    blocks = {}
    at = 0
    for number, signal in enumerate(signals):
        size = bytes_each * signal.per_record
        blocks[number] = raw[:, at : at + size]
        at += size
    starts_s = None
    if discontinuous:
        clock = next((n for n, signal in enumerate(signals) if signal.label in _ANNOTATIONS), None)
        if clock is None:
            raise PalpError(f"{path}: discontinuous, but without the annotations that say when records begin")
        starts_s = np.array([_onset(path, block.tobytes()) for block in blocks[clock]])
        notes.append("discontinuous: gaps count as lost samples")
    digital = {
        number: _integers(blocks[number], wide=wide)
        for number, signal in enumerate(signals)
        if signal.label not in (*_ANNOTATIONS, _TRIGGERS if wide else "") and signal.per_record > 0
    }
    padded = min((_held_share(values[-1]) for values in digital.values()), default=0.0)
    if padded > 0.0:
        notes.append(f"the last record is padded; its last {padded * record_s:.3g} s are left out")
    columns = []
    for number, values in digital.items():
        signal = signals[number]
        rate_hz = signal.per_record / record_s
        physical = _scaled(values, signal)
        samples = physical.ravel() if starts_s is None else _spread(physical, starts_s, rate_hz)
        there = samples.size - round(padded * signal.per_record)
        columns.append(Column(signal.label, samples[:there], rate_hz, signal.unit))
    return EmgFile(path, "BDF" if wide else "EDF", tuple(columns), notes=tuple(notes))


def _header(data: bytes) -> tuple[list[_Signal], int, float, bool, int]:
    """Return signals, number of records (-1: unknown), seconds of each, whether it has gaps, its size."""
    count = int(data[252:256])
    begin = _MAIN * (1 + count)
    if count < 1 or len(data) < begin:
        raise ValueError(f"{count} signals in {len(data)} bytes")
    fields: list[list[str]] = []
    at = _MAIN
    for width in _WIDTHS:
        fields.append(
            [data[at + i * width : at + (i + 1) * width].decode("latin-1").strip() for i in range(count)]
        )
        at += width * count
    signals = [
        _Signal(
            fields[0][i],
            fields[2][i],
            (float(fields[3][i]), float(fields[4][i])),
            (float(fields[5][i]), float(fields[6][i])),
            int(fields[8][i]),
        )
        for i in range(count)
    ]
    if min(signal.per_record for signal in signals) < 0:
        raise ValueError("a negative number of samples in a record")
    if any(s.digital[0] == s.digital[1] for s in signals if s.label not in _ANNOTATIONS):
        raise ValueError("a signal whose digital range is empty")
    return signals, int(data[236:244]), float(data[244:252]), data[192:197] in (b"EDF+D", b"BDF+D"), begin


def _integers(block: NDArray[np.uint8], *, wide: bool) -> Float64Array:
    """Return the little-endian integers of the records, shape (records, samples)."""
    if not wide:
        return np.ascontiguousarray(block).view("<i2").astype(np.float64)
    parts = block.reshape(len(block), -1, 3).astype(np.int32)
    value = parts[..., 0] | parts[..., 1] << 8 | parts[..., 2] << 16
    return (value - ((value & 0x800000) << 1)).astype(np.float64)


def _held_share(record: Float64Array) -> float:
    """Return which share of a record, at its end, is one value; 0 where that is all of it or next to nothing.

    A record cannot be shorter than the others, so a writer fills the last one up.
    """
    moves = np.flatnonzero(record[1:] != record[:-1])
    held = record.size - 1 - int(moves[-1]) if moves.size else 0
    return held / record.size if held >= _LEAST_PADDING else 0.0


def _scaled(digital: Float64Array, signal: _Signal) -> Float64Array:
    (low, high), (least, most) = signal.physical, signal.digital
    return np.asarray(low + (digital - least) * (high - low) / (most - least))


def _onset(path: Path, annotations: bytes) -> float:
    """Return when a record begins: the number before the first annotation's mark."""
    try:
        return float(annotations.split(b"\x14", 1)[0].split(b"\x15", 1)[0])
    except ValueError as error:
        raise PalpError(f"{path}: a record does not say when it begins") from error


def _spread(values: Float64Array, starts_s: Float64Array, rate_hz: float) -> Float64Array:
    places = np.rint((starts_s - starts_s[0]) * rate_hz).astype(np.int64)
    size = values.shape[1]
    if (np.diff(places) < size).any():
        raise PalpError("records of a discontinuous file overlap")
    if places[-1] > 1000 * values.size:
        raise PalpError("the gaps of a discontinuous file are a thousand times its records; split it")
    grid = np.full(int(places[-1]) + size, np.nan)
    for place, row in zip(places.tolist(), values, strict=True):
        grid[place : place + size] = row
    return grid
