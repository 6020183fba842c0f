"""Files of arrays: NumPy, MATLAB and HDF5, all read as leaves with a path of names."""

import re
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.extras import install_line
from palp_core.palpation.identification.emg.files import Column, EmgFile, split_unit

_RATE = re.compile(
    r"(^|[._/])(fs|srate|sf|freq|frequency|(sampl\w*[_ ]?)?rate(_hz)?|samp\w*[_ ]?freq\w*)$", re.IGNORECASE
)
_LABELS = re.compile(r"(^|[._/])(labels?|columns?|channels?|chan_?names?|names?|muscles?)$", re.IGNORECASE)
_LEAST = 8  # values; what is shorter is a setting


_HDF5 = b"\x89HDF\r\n\x1a\n"


def read_numpy(path: Path) -> EmgFile:
    """Read an array or an archive of arrays; structured arrays by their fields. Nothing is unpickled.

    Raises:
        PalpError: It is no NumPy file, or holds Python objects.
    """
    try:
        if path.suffix.lower() == ".npz":
            with np.load(path, allow_pickle=False) as archive:
                leaves = dict(_leaves(dict(archive.items())))
        else:
            leaves = dict(_leaves({"": np.load(path, allow_pickle=False)}))
    except (ValueError, EOFError, zipfile.BadZipFile, AttributeError) as error:
        raise PalpError(f"{path}: not a NumPy file of plain numbers: {error}") from error
    return _file(path, "NumPy", leaves)


def read_matlab(path: Path) -> EmgFile:
    """Read a .mat file; structs become dotted names. Version 7.3 is HDF5.

    Raises:
        PalpError: It is no MATLAB file, or version 7.3 and h5py is not installed.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    with path.open("rb") as file:
        if file.read(len(_HDF5)) == _HDF5:  # saved as HDF5 without MATLAB's own heading
            return read_hdf5(path)
    try:
        content = loadmat(path, simplify_cells=True)
    except NotImplementedError:
        return read_hdf5(path)
    except (MatReadError, ValueError, TypeError, EOFError) as error:
        raise PalpError(f"{path}: not a MATLAB file: {error}") from error
    return _file(path, "MATLAB", dict(_leaves({k: v for k, v in content.items() if not k.startswith("__")})))


def read_hdf5(path: Path) -> EmgFile:
    """Read the datasets of an HDF5 file, and attributes that name rate, unit or columns.

    Raises:
        PalpError: It is no HDF5 file, or h5py is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise PalpError(f"{path}: HDF5 needs h5py; install it with: {install_line('emg')}") from error

    leaves: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        if name.startswith("#"):  # MATLAB's store of references
            return
        prefix = name.replace("/", ".")
        if isinstance(item, h5py.Dataset):
            value = item.asstr()[()] if h5py.check_string_dtype(item.dtype) else item[()]
            if item.attrs.get("MATLAB_class") == b"char":  # text as numbers of its letters
                value = "".join(map(chr, np.ravel(value)))
            leaves.update(_leaves({prefix: value}))
        for key, value in item.attrs.items():
            leaves[f"{prefix}.{key}".lstrip(".")] = value

    try:
        with h5py.File(path, "r") as file:
            visit("", file)
            file.visititems(visit)
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise PalpError(f"{path}: not a readable HDF5 file: {error}") from error
    return _file(path, "HDF5", leaves)


def _leaves(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in content.items():
        name = f"{prefix}.{key}".strip(".")
        if isinstance(value, Mapping):
            yield from _leaves(value, name)
        elif isinstance(value, np.ndarray) and value.dtype.names:
            yield from _leaves({field: value[field] for field in value.dtype.names}, name)
        else:
            yield name, value


def _file(path: Path, kind: str, leaves: Mapping[str, Any]) -> EmgFile:
    rate_hz = next(
        (float(np.ravel(v)[0]) for k, v in leaves.items() if _RATE.search(k) and _is_scalar(v)), None
    )
    labels = [_texts(value) for key, value in leaves.items() if _LABELS.search(key)]
    columns: list[Column] = []
    for name, value in leaves.items():
        array = np.squeeze(np.asarray(value)) if not isinstance(value, str | bytes) else np.zeros(0)
        if array.dtype.kind not in "iufb" or array.size < _LEAST or array.ndim > 2:
            continue
        unit = next(
            (t[0] for k in ("unit", "units") if len(t := _texts(leaves.get(f"{name}.{k}".lstrip(".")))) == 1),
            "",
        )
        rows = (
            [array] if array.ndim == 1 else list(array if len(array) < array.size // len(array) else array.T)
        )
        named = next((one for one in labels if len(one) == len(rows)), None)
        for i, row in enumerate(rows):
            plain = name if array.ndim == 1 and name else f"{name}[{i}]" if name else f"column{i}"
            heading, stated = split_unit(named[i] if named and array.ndim == 2 else plain)
            if heading != plain and not named:
                heading = plain
            columns.append(Column(heading, row.astype(np.float64), rate_hz, unit or stated))
    return EmgFile(path, kind, tuple(columns))


def _is_scalar(value: Any) -> bool:
    array = np.asarray(value)
    return array.size == 1 and array.dtype.kind in "iuf" and float(np.ravel(array)[0]) > 0.0


def _texts(value: Any) -> list[str]:
    if value is None:
        return []
    flat = [value] if isinstance(value, str | bytes) else list(np.ravel(np.asarray(value)))
    texts = [one.decode("utf-8", "replace") if isinstance(one, bytes) else one for one in flat]
    return [str(one).strip() for one in texts] if all(isinstance(one, str) for one in texts) else []
