"""NumPy archives of plain arrays; nothing is unpickled."""

import re
from pathlib import Path

import numpy as np

from palp_core.errors import PalpError
from palp_core.foreign import catch_foreign
from palp_core.palpation.identification.emg.files import LARGEST_BYTES, Column, EmgFile, split_unit

_RATE = re.compile(
    r"fs|sr|srate|sfreq|(sampl(e|es|ing)[_ ]?)(rate|freq|frequency)|rate", re.IGNORECASE
)  # whole keys, but for a unit behind: not frame_rate, heart_rate, line_frequency
_HINT = re.compile(r"fs|rate|freq|hz", re.IGNORECASE)
_LEAST = 8  # values; what is shorter is a setting


def read_npz(path: Path) -> EmgFile:
    """Read an archive of arrays: one dimension is a column, the longer of two runs over the samples."""
    with catch_foreign(f"{path}: not a readable NPZ file", PalpError, "write plain arrays with numpy.savez"):
        archive = np.load(path, allow_pickle=False)
        if isinstance(archive, np.ndarray):
            raise PalpError(f"{path}: a single array, not an archive; write it with numpy.savez")
        if sum(entry.file_size for entry in archive.zip.infolist()) > LARGEST_BYTES:
            raise PalpError(f"{path}: unpacks to more than {LARGEST_BYTES >> 30} GiB")
        arrays = {name: np.asarray(archive[name]) for name in archive.files}
    rates = {}
    for name, array in arrays.items():
        key = re.sub(r"[_ ]?\(?hz\)?$", "", name, flags=re.IGNORECASE)
        if (
            _RATE.fullmatch(key)
            and array.size == 1
            and array.dtype.kind in "iuf"
            and 0 < array.item() < np.inf
        ):
            rates[f"key '{name}'"] = float(array.item())
    if len(rates) > 1 and max(rates.values()) / min(rates.values()) > 1.01:
        raise PalpError(
            f"{path}: rates differ: {', '.join(f'{k} {v:g} Hz' for k, v in rates.items())}; keep one"
        )
    rate_from, rate_hz = next(iter(rates.items()), ("the file", None))
    columns, notes = [], []
    for name, array in arrays.items():
        fields = {f"{name}.{one}": array[one] for one in array.dtype.names or ()} or {name: array}
        for key, values in fields.items():
            values = np.squeeze(values)
            heading, unit = split_unit(key)
            if values.dtype.kind in "mM" and values.ndim == 1:  # NumPy's own times
                values, unit = (values - values[0]) / np.timedelta64(1, "s"), "s"
            if values.size < _LEAST:
                continue
            if values.dtype.kind not in "iufb" or values.ndim > 2:
                notes.append(f"key '{key}' is left out: {values.dtype} of shape {values.shape}")
                continue
            if values.ndim == 2 and len(set(values.shape)) == 1:
                raise PalpError(f"{path}: '{key}' is square; write each channel as an array of its own")
            rows = (
                [values] if values.ndim == 1 else list(values if len(values) < values.shape[1] else values.T)
            )
            for place, row in enumerate(rows):
                label = f"{heading}[{place}]" if values.ndim == 2 else heading
                columns.append(Column(label, row.astype(np.float64), unit, rate_hz))
    hints = [
        f"key '{one}' is {arrays[one]}" for one in arrays if arrays[one].size < _LEAST and _HINT.search(one)
    ]
    return EmgFile(path, "NPZ", tuple(columns), notes=tuple(notes), rate_from=rate_from, hints=tuple(hints))
