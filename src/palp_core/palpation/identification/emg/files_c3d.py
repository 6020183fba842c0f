"""C3D, the format of motion capture, as ezc3d reads it: its analog channels, EMG among them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.extras import install_line
from palp_core.palpation.identification.emg.files import UNIT, Column, EmgFile

_BLOCK = 512
_MAGIC = 0x50  # second byte of every C3D file
_INTEL = 84  # how numbers are stored; those of other processors are not counted after here
_FLOAT_BYTES, _INTEGER_BYTES = 4, 2
_POINT_VALUES = 4
_BROKEN = (ValueError, KeyError, IndexError, TypeError, RuntimeError, MemoryError, OverflowError)


def read_c3d(path: Path) -> EmgFile:
    """Read the analog channels whose unit may be one of EMG; force plates have others.

    Raises:
        PalpError: It is no C3D file, is cut off or damaged, has no such channel, or ezc3d is not installed.
    """
    try:
        import ezc3d
    except ImportError as error:
        raise PalpError(f"{path}: C3D needs ezc3d; install it with: {install_line('emg')}") from error
    with path.open("rb") as file:
        header = file.read(_BLOCK)
    if len(header) < _BLOCK or header[1] != _MAGIC:
        raise PalpError(f"{path}: not a C3D file; its first bytes are {header[:4]!r}")
    counts = _counts(path, header)
    if counts is not None:
        _refuse_cut(path, header, counts)
    try:
        content = ezc3d.c3d(str(path))
        analog = content["parameters"].get("ANALOG", {})
        samples = np.asarray(content["data"]["analogs"], dtype=np.float64)[0]
        points = content["data"]["points"].shape
        rate_hz = float(np.ravel(analog["RATE"]["value"])[0]) if samples.size else 0.0
        labels, units = _texts(analog, "LABELS"), _texts(analog, "UNITS")
    except (*_BROKEN, OSError) as error:
        raise PalpError(f"{path}: damaged C3D file: {type(error).__name__}: {error}") from error
    if counts is not None:
        _refuse_other(path, counts, points[1:], samples.size)
    if samples.size == 0:
        raise PalpError(f"{path}: has no EMG: no analog channel, only {points[1]} markers")
    if not rate_hz > 0.0:
        raise PalpError(f"{path}: its analog channels have no rate")
    columns, others = [], []
    for place, row in enumerate(samples):
        label = labels[place] if place < len(labels) and labels[place] else f"analog {place + 1}"
        unit = units[place] if place < len(units) else ""
        if unit and not UNIT.fullmatch(unit):
            others.append(f"{label} ({unit})")
        else:
            columns.append(Column(label, row, rate_hz, unit))
    if not columns:
        raise PalpError(f"{path}: has no EMG: its analog channels are {', '.join(others)}")
    notes = (f"left out, in units that are none of EMG: {', '.join(others)}",) if others else ()
    return EmgFile(path, "C3D", tuple(columns), notes=notes)


def _texts(group: Any, name: str) -> list[str]:
    return [str(one).strip() for one in group.get(name, {}).get("value", ())]


def _refuse_cut(path: Path, header: bytes, counts: list[int]) -> None:
    """Refuse a file that ends before its frames do; ezc3d reads what is there, and does not say so.

    Raises:
        PalpError: It does.
    """
    points, analogs, first, last = counts
    (scale,), (begin,) = np.frombuffer(header[12:16], dtype="<f4"), np.frombuffer(header[16:18], dtype="<u2")
    values = (last - first + 1) * (_POINT_VALUES * points + analogs)
    needed = (int(begin) - 1) * _BLOCK + values * (_FLOAT_BYTES if scale < 0.0 else _INTEGER_BYTES)
    has = path.stat().st_size
    if has < needed:
        raise PalpError(
            f"{path}: is cut off: it has {has} bytes of the {needed} that its frames take; copy it again"
        )


def _counts(path: Path, header: bytes) -> list[int] | None:
    """Return the markers and analog values of a frame, and its first and last frame; None if not Intel's."""
    with path.open("rb") as file:
        file.seek(max(header[0] - 1, 0) * _BLOCK)
        if file.read(4)[3:4] != bytes([_INTEL]):
            return None
    counts: list[int] = np.frombuffer(header[2:10], dtype="<u2").tolist()
    return counts


def _refuse_other(path: Path, counts: list[int], points: tuple[int, int], values: int) -> None:
    """Refuse a file whose parameters say other things than its header: markers would be read as EMG.

    Raises:
        PalpError: They do.
    """
    markers, frames = points
    said, found = counts[:2], [markers, values // max(frames, 1)]
    if frames and said != found:
        raise PalpError(
            f"{path}: damaged C3D file: its header has {said[0]} markers and {said[1]} analog values a frame,"
            f" its parameters {found[0]} and {found[1]}; copy it again"
        )
