"""European Data Format, EDF and EDF+ (16 bit), and BioSemi's BDF and BDF+ (24 bit), as edfio reads them.

What fills up the last record is left out, and a header that promises another number of records is noted.
"""

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
_TRIGGERS = "Status"  # BioSemi's channel of bits


def read_edf(path: Path) -> EmgFile:
    """Read every signal that can be scaled to its physical unit."""
    data = path.read_bytes()
    wide = data[:1] == b"\xff"
    if not wide and data[:8].strip(b" \0") != b"0":
        raise PalpError(f"{path}: not an EDF or BDF file; its first bytes are {data[:8]!r}")
    kind = "BDF" if wide else "EDF"
    with catch_foreign(f"{path}: not a readable {kind} file", PalpError):
        file = (read_bdf if wide else read_narrow)(data, header_encoding="latin-1")
        promised, there, record_s = int(data[_PROMISED]), file.num_data_records, file.data_record_duration
        signals = [one for one in file.signals if one.samples_per_data_record > 0]
        shown = [one for one in signals if _can_be_scaled(one) and not (wide and one.label == _TRIGGERS)]
        samples = [_physical(one) for one in shown]
    if file.reserved.startswith(("EDF+D", "BDF+D")):
        raise PalpError(
            f"{path}: its records have gaps ({kind}+D); export it as continuous, or split it there"
        )
    if there < 1 or record_s <= 0.0:
        raise PalpError(f"{path}: no whole record of positive duration after the header")
    if not shown:
        labels = ", ".join(one.label for one in signals) or "annotations only"
        raise PalpError(f"{path}: holds no usable signal ({labels}); name a file with EMG")
    notes = [
        f"signal '{one.label}' is left out: its range in the header is empty"
        for one in signals
        if not _can_be_scaled(one)
    ]
    if 0 <= promised != there:
        notes.append(f"the header promises {promised} records, the file has {there}")
    padded = min(_held_share(one.digital[-one.samples_per_data_record :]) for one in shown)
    if padded > 0.0:
        notes.append(f"the last record is padded; its last {padded * record_s:.3g} s are left out")
    columns = []
    for one, values in zip(shown, samples, strict=True):
        per_record = one.samples_per_data_record
        kept = values[: values.size - round(padded * per_record)]
        columns.append(Column(one.label, kept, plain_unit(one.physical_dimension), per_record / record_s))
    return EmgFile(path, kind, tuple(columns), notes=tuple(notes), rate_from="the header's record length")


def _can_be_scaled(signal: EdfSignal | BdfSignal) -> bool:
    (least, most), (low, high) = signal.digital_range, signal.physical_range
    return least != most and low != high


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
