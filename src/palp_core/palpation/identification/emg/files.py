"""Read a recording of EMG from any of the usual files, as named columns with rate and unit where stated.

What a file does not state is guessed in :mod:`palp_core.palpation.identification.emg.guess`, never here.
"""

import importlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from palp_core.errors import PalpError
from palp_core.published import EMG_READERS, published
from palp_core.units import Float64Array
from palp_core.whole_file import check_regular


@dataclass(frozen=True, eq=False)
class Column:
    """A column of numbers.

    Attributes:
        name: As in the file.
        samples: Shape (n,); NaN where the file has none.
        rate_hz: Sampling rate that the file states; None if it does not.
        unit: Unit that the file states; empty if it does not.
    """

    name: str
    samples: Float64Array
    rate_hz: float | None = None
    unit: str = ""


@dataclass(frozen=True, eq=False)
class EmgFile:
    """What a file holds.

    Attributes:
        path: The file.
        format: Name of its format.
        columns: Its columns of numbers.
        phases: Stretches of samples [begin, end) by phase, as ``mvc``; empty where the file has none.
        notes: What a reader of the numbers ought to know.
        begin_s: Time of the first sample on the clock of its run; 0 where the file has no such clock.
    """

    path: Path
    format: str
    columns: tuple[Column, ...]
    phases: Mapping[str, tuple[tuple[int, int], ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    begin_s: float = 0.0


UNIT = re.compile(r"s|ms|us|[µμ]s|ns|sec(onds)?|(n|u|µ|μ|m)?v(olts?)?|hz|counts?|adc|a\.?u\.?", re.IGNORECASE)
"""What is taken for a unit."""

LARGEST_BYTES = 2 << 30
"""What is read of one file."""

_HERE = "palp_core.palpation.identification.emg"
_READERS = {
    ".csv": f"{_HERE}.files_text:read_text",
    ".tsv": f"{_HERE}.files_text:read_text",
    ".txt": f"{_HERE}.files_text:read_text",
    ".npy": f"{_HERE}.files_array:read_numpy",
    ".npz": f"{_HERE}.files_array:read_numpy",
    ".mat": f"{_HERE}.files_array:read_matlab",
    ".h5": f"{_HERE}.files_array:read_hdf5",
    ".hdf5": f"{_HERE}.files_array:read_hdf5",
    ".edf": f"{_HERE}.files_edf:read_edf",
    ".bdf": f"{_HERE}.files_edf:read_edf",
    ".xdf": f"{_HERE}.files_xdf:read_xdf",
    ".xdfz": f"{_HERE}.files_xdf:read_xdf",
    ".c3d": f"{_HERE}.files_c3d:read_c3d",
    ".mcap": f"{_HERE}.files_bag:read_bag",
}


def _readers() -> dict[str, str]:
    """Return what reads which suffix: palp's own, then what packages publish (``palp.emg_readers``)."""
    others = {f".{name.lower().lstrip('.')}": where for name, where in published(EMG_READERS).items()}
    return {**_READERS, **{suffix: others[suffix] for suffix in others if suffix not in _READERS}}


def is_recording(path: Path) -> bool:
    """Tell whether a path is a file of a known kind, or a bag's folder."""
    return path.suffix.lower() in _readers() if path.is_file() else any(path.glob("*.mcap"))


def read_emg(path: Path) -> EmgFile:
    """Read a recording; its suffix says how.

    Raises:
        PalpError: No such file, an unknown kind, or not what its suffix says.
    """
    if not path.exists():
        raise PalpError(f"{path}: no such file{'' if path.is_absolute() else f' in {Path.cwd()}'}")
    if path.is_dir() and not is_recording(path):
        raise PalpError(f"{path}: a folder without a bag; name a recording")
    suffix = ".mcap" if path.is_dir() else path.suffix.lower()
    if suffix not in (readers := _readers()):
        raise PalpError(f"{path}: '{path.suffix}' is no known kind of recording; known: {' '.join(readers)}")
    module, _, name = readers[suffix].partition(":")
    try:
        if suffix != ".mcap":
            check_regular(path, LARGEST_BYTES)
        found = getattr(importlib.import_module(module), name)(path)
    except (AttributeError, ModuleNotFoundError) as error:
        if suffix in _READERS:
            raise
        raise PalpError(f"{path}: cannot load its reader {readers[suffix]}: {error}") from error
    except OSError as error:
        raise PalpError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not isinstance(found, EmgFile):  # of another package's reader
        raise PalpError(f"{path}: {readers[suffix]} returned no EmgFile but {type(found).__name__}")
    if not found.columns:
        raise PalpError(f"{path}: holds no column of numbers")
    return found


def split_unit(heading: str) -> tuple[str, str]:
    """Split a heading as ``FDS (uV)``, ``FDS [mV]`` or ``fds_v`` into name and unit; other brackets stay.

    >>> split_unit("FDS (uV)"), split_unit("fds_v"), split_unit("EDC (left)")
    (('FDS', 'uV'), ('fds_v', 'V'), ('EDC (left)', ''))
    """
    heading = heading.strip().strip("\"'").strip()
    bracketed = re.fullmatch(r"(.*?)\s*[(\[]\s*([^()\[\]]{1,12})\s*[)\]]", heading)
    if bracketed and UNIT.fullmatch(bracketed[2].strip()):
        return bracketed[1].strip() or heading, bracketed[2].strip()
    suffix = re.search(r"_(n|u|µ|m)?v$", heading.lower())
    return heading, f"{suffix[1] or ''}V" if suffix else ""
