"""European Data Format, EDF and EDF+ (16 bit), and BioSemi's BDF and BDF+ (24 bit), as edfio reads them.

edfio reads the header and the integers. What it does not do is done here: gaps of a discontinuous file become
NaN (edfio keeps the begin of each record to itself), what fills up the last record is left out, and a header
that promises another number of records than there are is noted.
"""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from edfio import BdfSignal, EdfSignal, read_bdf
from edfio import read_edf as read_narrow
from numpy.typing import NDArray

from palp_core.errors import PalpError
from palp_core.palpation.identification.emg.files import Column, EmgFile
from palp_core.units import Float64Array

_LEAST_PADDING = 8  # samples; EMG does not stay that long at one value
_PROMISED = slice(236, 244)  # the header's number of records, which edfio mends to what it finds
_MAIN, _LABEL_WIDTH = 256, 16  # bytes of the main header, and of a label
_LENGTH = slice(184, 192)  # the header's own length
_BEFORE_LIMITS = 120  # bytes of each signal before its two digital limits: label, transducer, unit, range
_CLOCK = "Record begins"
_TRIGGERS = "Status"  # BioSemi's channel of bits


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
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a cut file and a wrong number of records: noted below
            file = (read_bdf if wide else read_narrow)(_as_edfio_reads(data), header_encoding="latin-1")
        promised, there, record_s = int(data[_PROMISED]), file.num_data_records, file.data_record_duration
        signals = {one: one.label.strip() for one in file.signals if one.samples_per_data_record > 0}
        shown = [one for one, label in signals.items() if label not in (_CLOCK, _TRIGGERS if wide else "")]
        samples = {one: _physical(one) for one in shown}
    except (
        ValueError,
        ArithmeticError,
        LookupError,
        NameError,
    ) as error:  # edfio's, on fields it cannot read
        raise PalpError(f"{path}: damaged EDF header: {error}") from error
    if there < 1 or record_s <= 0.0:
        raise PalpError(f"{path}: no whole record of positive duration after the header")
    notes = []
    if 0 <= promised != there:
        notes.append(f"the header promises {promised} records, the file has {there}")
    starts_s = None
    if file.reserved.startswith(("EDF+D", "BDF+D")):
        clock = next((one for one, label in signals.items() if label == _CLOCK), None)
        if clock is None:
            raise PalpError(f"{path}: discontinuous, but without the annotations that say when records begin")
        starts_s = np.array([_onset(path, record) for record in _bytes(clock, there, wide=wide)])
        notes.append("discontinuous: gaps count as lost samples")
    padded = min((_held_share(one.digital[-one.samples_per_data_record :]) for one in shown), default=0.0)
    if padded > 0.0:
        notes.append(f"the last record is padded; its last {padded * record_s:.3g} s are left out")
    columns = []
    for one in shown:
        rate_hz = one.samples_per_data_record / record_s
        values = samples[one]
        if starts_s is not None:
            values = _spread(values.reshape(there, -1), starts_s, rate_hz)
        end = values.size - round(padded * one.samples_per_data_record)
        columns.append(Column(signals[one], values[:end], rate_hz, one.physical_dimension.strip()))
    return EmgFile(path, "BDF" if wide else "EDF", tuple(columns), notes=tuple(notes))


def _as_edfio_reads(data: bytes) -> bytes:
    """Return a file whose header edfio reads as every other reader does.

    Its annotations become an ordinary signal, as edfio shows them without the records' begins. The length of
    the header follows from the number of signals, whatever the field of it says, and a digital limit may be
    written as ``-32768.0``.

    Raises:
        ValueError: The header does not say how many signals there are, or a digital limit is no number.
        OverflowError: A digital limit is infinite.
    """
    count = int(data[_MAIN - 4 : _MAIN])
    labels_end, begin = _MAIN + _LABEL_WIDTH * count, _MAIN * (1 + count)
    header = bytearray(data[:begin])
    header[_LENGTH] = b"%-8d" % begin
    for kind in (b"EDF", b"BDF"):
        annotations = kind + b" Annotations "
        header[_MAIN:labels_end] = header[_MAIN:labels_end].replace(
            annotations, _CLOCK.encode().ljust(_LABEL_WIDTH)
        )
    for at in range(_MAIN + _BEFORE_LIMITS * count, _MAIN + (_BEFORE_LIMITS + 16) * count, 8):
        header[at : at + 8] = b"%-8d" % float(header[at : at + 8])
    return bytes(header) + data[begin:]


def _held_share(record: NDArray[np.integer[Any]]) -> float:
    """Return which share of a record, at its end, is one value; 0 where that is all of it or next to nothing.

    A record cannot be shorter than the others, so a writer fills the last one up.
    """
    moves = np.flatnonzero(record[1:] != record[:-1])
    held = record.size - 1 - int(moves[-1]) if moves.size else 0
    return held / record.size if held >= _LEAST_PADDING else 0.0


def _physical(signal: EdfSignal | BdfSignal) -> Float64Array:
    """Return the samples in their unit; edfio's own give bare integers where the physical range is empty."""
    (least, most), (low, high) = signal.digital_range, signal.physical_range
    if least == most:
        raise ValueError("a signal whose digital range is empty")
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
