"""European Data Format, EDF and EDF+ (16 bit), and BioSemi's BDF and BDF+ (24 bit), as edfio reads them.

edfio reads the header and the integers. What it does not do is done here: records of a discontinuous file
keep their times (edfio keeps the begin of each record to itself), what fills up the last record is left out,
and a header that promises another number of records, or a signal that cannot be scaled, is noted.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
from edfio import BdfSignal, EdfSignal, read_bdf
from edfio import read_edf as read_narrow
from numpy.typing import NDArray

from palp_core.errors import PalpError
from palp_core.foreign import catch_foreign
from palp_core.palpation.identification.emg.files import Column, EmgFile, plain_unit
from palp_core.units import Float64Array

_LEAST_PADDING = 8  # samples; EMG does not stay that long at one value
_PROMISED = slice(236, 244)  # the header's number of records, which edfio mends to what it finds
_MAIN, _LABEL_WIDTH = 256, 16  # bytes of the main header, and of a label
_LENGTH = slice(184, 192)  # the header's own length
_BEFORE_RANGES = (
    104  # bytes of each signal before its two ranges, physical and digital: label, transducer, unit
)
_CLOCK = "Record begins"
_TRIGGERS = "Status"  # BioSemi's channel of bits


def read_edf(path: Path) -> EmgFile:
    """Read every signal that can be scaled to its physical unit.

    Raises:
        PalpError: The header is not that of EDF or BDF, no whole record follows it, or no signal.
    """
    data = path.read_bytes()
    wide = data[:1] == b"\xff"
    if not wide and data[:8].strip(b" \0") != b"0":
        raise PalpError(f"{path}: not an EDF or BDF file; its first bytes are {data[:8]!r}")
    with catch_foreign(f"{path}: not a readable {'BDF' if wide else 'EDF'} file", PalpError):
        plain, unusable = _as_edfio_reads(data)
        if set(_labels(plain)) == {_CLOCK}:
            raise PalpError(f"{path}: holds annotations only; name a file with EMG")
        file = (read_bdf if wide else read_narrow)(plain, header_encoding="latin-1")
        promised, there, record_s = int(plain[_PROMISED]), file.num_data_records, file.data_record_duration
        signals = {one: one.label.strip() for one in file.signals if one.samples_per_data_record > 0}
        hidden = (_CLOCK, _TRIGGERS if wide else "")
        shown = [
            one
            for place, one in enumerate(file.signals)
            if one in signals and place not in unusable and signals[one] not in hidden
        ]
        samples = {one: _physical(one) for one in shown}
        left_out = [_labels(plain)[place] for place in unusable]
    if there < 1 or record_s <= 0.0:
        raise PalpError(f"{path}: no whole record of positive duration after the header")
    if not shown:
        raise PalpError(f"{path}: holds no usable signal ({', '.join(left_out)}); name a file with EMG")
    notes = [
        f"signal '{label}' is left out: its range in the header is empty or no number" for label in left_out
    ]
    if 0 <= promised != there:
        notes.append(f"the header promises {promised} records, the file has {there}")
    starts_s = None
    if file.reserved.startswith(("EDF+D", "BDF+D")):
        clock = next((one for one, label in signals.items() if label == _CLOCK), None)
        if clock is None:
            raise PalpError(f"{path}: discontinuous, without annotations of the records' times")
        starts_s = np.array([_onset(path, record) for record in _bytes(clock, there, wide=wide)])
    padded = min(_held_share(one.digital[-one.samples_per_data_record :]) for one in shown)
    if padded > 0.0:
        notes.append(f"the last record is padded; its last {padded * record_s:.3g} s are left out")
    columns = []
    for one in shown:
        per_record = one.samples_per_data_record
        end = samples[one].size - round(padded * per_record)
        times_s = None
        if starts_s is not None:
            times_s = np.add.outer(starts_s, np.arange(per_record) * record_s / per_record).ravel()[:end]
        unit = plain_unit(one.physical_dimension)
        columns.append(Column(signals[one], samples[one][:end], unit, per_record / record_s, times_s))
    return EmgFile(
        path,
        "BDF" if wide else "EDF",
        tuple(columns),
        notes=tuple(notes),
        rate_from="the header's record length",
    )


def _as_edfio_reads(data: bytes) -> tuple[bytes, list[int]]:
    """Return a file whose header edfio reads as other readers do, and the signals without a usable range.

    NULs in it become blanks. Its annotations become an ordinary signal, as edfio shows them without the
    records' begins. The length of the header follows from the number of signals, whatever the field of it
    says, and a limit may be written as ``-32768.0``.
    """
    count = int(data[_MAIN - 4 : _MAIN].replace(b"\0", b" "))
    labels_end, begin = _MAIN + _LABEL_WIDTH * count, _MAIN * (1 + count)
    header = bytearray(data[:begin].replace(b"\0", b" "))
    header[_LENGTH] = b"%-8d" % begin
    for kind in (b"EDF", b"BDF"):
        annotations = kind + b" Annotations "
        header[_MAIN:labels_end] = header[_MAIN:labels_end].replace(
            annotations, _CLOCK.encode().ljust(_LABEL_WIDTH)
        )
    unusable = []
    for place in range(count):
        at = [_MAIN + _BEFORE_RANGES * count + 8 * (place + field * count) for field in range(4)]
        limits = [_number(header[one : one + 8]) for one in at]
        if not all(map(math.isfinite, limits)) or limits[0] == limits[1] or limits[2] == limits[3]:
            unusable.append(place)
            limits = [-1.0, 1.0, -1.0, 1.0]
            header[at[0] : at[0] + 8], header[at[1] : at[1] + 8] = b"-1      ", b"1       "
        for one, limit in zip(at[2:], limits[2:], strict=True):
            header[one : one + 8] = b"%-8d" % round(limit)
    return bytes(header) + data[begin:], unusable


def _labels(data: bytes) -> list[str]:
    names = [data[_MAIN + i * _LABEL_WIDTH :][:_LABEL_WIDTH] for i in range(int(data[_MAIN - 4 : _MAIN]))]
    return [name.decode("latin-1").strip() for name in names]


def _number(field: bytearray) -> float:
    try:
        return float(field)
    except ValueError:
        return math.nan


def _held_share(record: NDArray[np.integer[Any]]) -> float:
    """Return which share of a record, at its end, is one value; 0 where that is all of it or next to nothing.

    A record cannot be shorter than the others, so a writer fills the last one up.
    """
    moves = np.flatnonzero(record[1:] != record[:-1])
    held = record.size - 1 - int(moves[-1]) if moves.size else 0
    return held / record.size if held >= _LEAST_PADDING else 0.0


def _physical(signal: EdfSignal | BdfSignal) -> Float64Array:
    """Return the samples in their unit."""
    (least, most), (low, high) = signal.digital_range, signal.physical_range
    return np.asarray(low + (signal.digital.astype(np.float64) - least) * (high - low) / (most - least))


def _bytes(clock: EdfSignal | BdfSignal, record_count: int, *, wide: bool) -> list[bytes]:
    """Return the text of each record's annotations."""
    whole = clock.digital.astype("<i4" if wide else "<i2").view(np.uint8)
    text = whole.reshape(-1, 4)[:, :3] if wide else whole
    return [row.tobytes() for row in text.reshape(record_count, -1)]


def _onset(path: Path, annotations: bytes) -> float:
    """Return when a record begins: the number before the first annotation's mark."""
    try:
        return float(annotations.split(b"\x14", 1)[0].split(b"\x15", 1)[0])
    except ValueError as error:
        raise PalpError(f"{path}: a record has no start time") from error
