"""European Data Format, EDF and EDF+ (16 bit), and BioSemi's BDF and BDF+ (24 bit).

A column is a signal, at its place in the file; annotations, and what cannot be scaled, have no samples.
Records of a discontinuous file keep their times, what fills up the last record is left out, and where the
file is not what its header promises, that is noted.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palp_core.counted import counted
from palp_core.errors import PalpError
from palp_core.palpation.identification.emg.files import Column, EmgFile, plain_unit
from palp_core.units import Float64Array

_LEAST_PADDING = 8  # samples; EMG does not stay that long at one value
_MAIN = 256  # bytes of the main header, and of what it has of each signal
_RESERVED, _PROMISED, _DURATION, _COUNT = slice(192, 236), slice(236, 244), slice(244, 252), slice(252, 256)
_WIDTHS = (16, 80, 8, 8, 8, 8, 8, 80, 8, 32)  # bytes of a signal's fields; each field has all signals in turn
_LABEL, _UNIT, _LIMITS, _SIZE = 0, 2, slice(3, 7), 8  # fields that count here
_ANNOTATIONS = ("EDF Annotations", "BDF Annotations")
_ONSET = re.compile(rb"([+-]\d+(?:\.\d*)?)[\x14\x15]")  # begin of a record, in its first annotation
_ROUNDED_S = 2e-3  # by which it may be off as it is written


@dataclass(frozen=True, eq=False)
class _Signal:
    label: str
    unit: str
    limits: list[float]  # Physical minimum and maximum, and the digital ones
    size: int  # Samples of a record
    records: NDArray[np.uint8]  # Shape (records, bytes)

    @property
    def holds_text(self) -> bool:
        return self.label in _ANNOTATIONS

    @property
    def scales(self) -> bool:
        """Whether its limits give the physical unit of a digital step."""
        low, high, least, most = self.limits
        return all(map(math.isfinite, self.limits)) and low != high and least != most

    def samples(self) -> Float64Array:
        """Return the samples in their unit, shape (records, size); of what has no number none."""
        if self.holds_text or not self.scales or not self.size:
            return np.empty((len(self.records), 0))
        low, high, least, most = self.limits
        width = self.records.shape[1] // self.size
        whole = np.zeros((len(self.records), self.size, 4), np.uint8)
        whole[:, :, 4 - width :] = self.records.reshape(-1, self.size, width)
        digital = whole.view("<i4")[:, :, 0] >> 8 * (4 - width)
        return np.asarray(low + (digital - least) * (high - low) / (most - least))


def read_edf(path: Path) -> EmgFile:
    """Read every signal that can be scaled to its physical unit.

    Raises:
        PalpError: The header is not that of EDF or BDF, no whole record follows it, or no signal.
    """
    data = path.read_bytes()
    wide = data[:1] == b"\xff"
    if not wide and data[:8].strip(b" \0") != b"0":
        raise PalpError(f"{path}: not an EDF or BDF file; its first bytes are {data[:8]!r}")
    signals, notes = _signals(path, data, 3 if wide else 2)
    measured = [one for one in signals if one.size and not one.holds_text]
    if not measured:
        raise PalpError(f"{path}: holds annotations only; name a file with EMG")
    record_s = _float(data[_DURATION])
    if not (math.inf > record_s > 0.0 and len(measured[0].records)):
        raise PalpError(
            f"{path}: no whole record of positive duration ('{_text(data[_DURATION])}' s) after the header; "
            "record or copy it again"
        )
    left_out = [one.label for one in measured if not one.scales]
    if len(left_out) == len(measured):
        raise PalpError(f"{path}: holds no usable signal ({', '.join(left_out)}); name a file with EMG")
    notes += [
        f"signal '{one}' is left out: its range in the header is empty or no number" for one in left_out
    ]
    notes += [f"signal '{one.label}' has no samples" for one in signals if not one.size]
    samples = [one.samples() for one in signals]
    starts_s = _starts_s(path, signals, _text(data[_RESERVED])[4:5] == "D", record_s, notes)
    padded = min(_held_share(one[-1]) for one in samples if one.size) % 1.0  # 1: nothing ever moves
    if padded:
        notes.append(f"the last record is padded; its last {padded * record_s:.3g} s are left out")
    columns = []
    for signal, values in zip(signals, samples, strict=True):
        size = values.shape[1]
        end = values.size - round(padded * size)
        rate_hz = signal.size / record_s if size else None
        times_s = None
        if starts_s is not None:
            times_s = np.add.outer(starts_s, np.arange(size) * record_s / max(1, size)).ravel()[:end]
        columns.append(Column(signal.label, values.ravel()[:end], plain_unit(signal.unit), rate_hz, times_s))
    return EmgFile(
        path,
        "BDF" if wide else "EDF",
        tuple(columns),
        notes=tuple(notes),
        rate_from="the header's record length",
    )


def _signals(path: Path, data: bytes, width: int) -> tuple[list[_Signal], list[str]]:
    """Return the signals, and where the file is not what its header promises.

    The header is as long as its signals need, whatever its own field says of that.
    """
    count = _whole(path, "number of signals", data[_COUNT], least=1)
    if len(data) < (begin := _MAIN * (1 + count)):
        raise PalpError(f"{path}: its header of {counted(count, 'signal')} is cut; record or copy it again")
    fields: list[list[bytes]] = []
    at = _MAIN
    for field_width in _WIDTHS:
        fields.append([data[at + i * field_width :][:field_width] for i in range(count)])
        at += field_width * count
    sizes = [_whole(path, f"number of samples of signal {i}", field) for i, field in enumerate(fields[_SIZE])]
    ends = [width * sum(sizes[:i]) for i in range(count + 1)]
    there, rest = divmod(len(data) - begin, max(1, ends[-1]))
    records = np.frombuffer(data, np.uint8, there * ends[-1], begin).reshape(there, ends[-1])
    notes = []
    if (promised := _float(data[_PROMISED])) == -1:
        notes.append(
            f"the recording was not closed: the header leaves the number of records open, it has {there}"
        )
    elif promised != there:
        notes.append(f"the header promises {_text(data[_PROMISED]) or 'no'} records, the file has {there}")
    if rest:
        notes.append(f"{counted(rest, 'byte')} after the last whole record left out")
    filled = 1 + int(np.flatnonzero(records.any(axis=1)).max(initial=-1))
    if filled < there:
        notes.append(f"{counted(there - filled, 'record')} of NUL at the end left out")
        records = records[:filled]
    return [
        _Signal(
            _text(fields[_LABEL][i]),
            _text(fields[_UNIT][i]),
            [_float(field[i]) for field in fields[_LIMITS]],
            size,
            records[:, ends[i] : ends[i + 1]],
        )
        for i, size in enumerate(sizes)
    ], notes


def _text(field: bytes) -> str:
    return field.replace(b"\0", b" ").decode("latin-1").strip()


def _float(field: bytes) -> float:
    """Return a number; NaN where the field has none."""
    try:
        return float(_text(field))
    except ValueError:
        return math.nan


def _whole(path: Path, name: str, field: bytes, least: int = 0) -> int:
    """Return a whole number on which the layout of the file depends."""
    number = _float(field)
    if not least <= number < math.inf or number % 1.0:
        raise PalpError(f"{path}: damaged header: its {name} is '{_text(field)}'; record or copy it again")
    return int(number)


def _held_share(record: Float64Array) -> float:
    """Return which share of a record, at its end, is one value; 0 where that is next to nothing.

    A record cannot be shorter than the others, so a writer fills the last one up.
    """
    moves = np.flatnonzero(record[1:] != record[:-1])
    held = record.size - 1 - int(moves[-1]) if moves.size else record.size
    return held / record.size if held >= _LEAST_PADDING else 0.0


def _starts_s(
    path: Path, signals: list[_Signal], apart: bool, record_s: float, notes: list[str]
) -> Float64Array | None:
    """Return when each record begins; None where each follows the one before."""
    clock = next((one for one in signals if one.holds_text and one.size), None)
    if clock is None:
        if apart:
            raise PalpError(
                f"{path}: discontinuous, without annotations of the records' times; export it again"
            )
        return None
    found = [_ONSET.match(record.tobytes()) for record in clock.records]
    starts_s = np.array([float(one[1]) if one else math.nan for one in found])
    fastest = max(one.size for one in signals if not one.holds_text)
    wrong = np.flatnonzero(np.abs(np.diff(starts_s) - record_s) > _ROUNDED_S + 1.5 * record_s / fastest) + 1
    if not apart and not wrong.size:
        if None in found:
            notes.append(
                f"record {found.index(None)} has no start time: each counts as following the one before"
            )
        return None
    if None in found:
        raise PalpError(f"{path}: record {found.index(None)} has no start time; record or copy it again")
    if not apart:
        at = int(wrong[0])
        notes.append(
            f"marked as continuous, but record {at} begins {starts_s[at] - starts_s[at - 1]:.6g} s after the "
            f"one before, not {record_s:g} s: the records' own times count"
        )
    return starts_s
