"""Read a recording of EMG: columns with index, name, unit and samples, and what the file says of time.

Nothing is chosen here: :mod:`palp_core.palpation.identification.emg.muscles` does.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from palp_core.errors import PalpError
from palp_core.foreign import catch_foreign, import_foreign
from palp_core.published import EMG_READERS, published
from palp_core.units import Float64Array
from palp_core.whole_file import check_regular


@dataclass(frozen=True, eq=False)
class Column:
    """A column; its index is its place in the file. One that holds no numbers has no samples."""

    name: str  # As in the file; two columns may have one name
    samples: Float64Array  # Shape (n,); NaN where a number is missing
    unit: str = ""  # Unit that the file states, as plain_unit writes it; empty if it states none
    rate_hz: float | None = None  # Sampling rate by a field of the format; None if it has none
    # Time of each sample, shape (n,), where the format has a clock for it
    times_s: Float64Array | None = None


@dataclass(frozen=True, eq=False)
class EmgFile:
    """What a file holds."""

    path: Path  # The file
    format: str  # Name of its format
    columns: tuple[Column, ...]  # Its columns of numbers
    # Stretches of samples [begin, end) by phase, as `mvc`; empty where the file has none
    phases: Mapping[str, tuple[tuple[int, int], ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # What a reader of the numbers ought to know
    # Time of the first sample on the clock of its run; 0 where the file has no such clock
    begin_s: float = 0.0
    rate_from: str = "the file"  # Source of the sampling rate, as `key 'fs'`
    lines: Sequence[int] = ()  # Line of the file of each sample; empty where the format has no lines
    # Lines of free text that speak of a rate; none is believed, errors quote them
    hints: tuple[str, ...] = ()

    def label(self, index: int) -> str:
        """Return a column's index, name and unit, as ``1 'FDS' [uV]``."""
        column = self.columns[index]
        return f"{index} '{column.name}'" + (f" [{column.unit}]" if column.unit else "")

    def place(self, sample: int) -> str:
        """Return the place of a sample in the file."""
        return f"line {self.lines[sample]}" if len(self.lines) else f"sample {sample}"


VOLTS = {"V": 1.0, "mV": 1e-3, "uV": 1e-6, "nV": 1e-9}
"""Units of voltage, and a volt's share of each."""

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
"""Units of time in seconds."""

LARGEST_BYTES = 2 << 30
"""What is read of one file."""

_PREFIXES = {"nano": "n", "micro": "u", "milli": "m", "": ""}
_SPELLINGS = (
    {one.lower(): one for one in VOLTS}
    | {f"{long}volt{end}": f"{short}V" for long, short in _PREFIXES.items() for end in ("", "s")}
    | {one: one for one in SECONDS}
    | {
        f"{long}sec{end}": f"{short}s"
        for long, short in _PREFIXES.items()
        for end in ("", "s", "ond", "onds")
    }
    | {"count": "counts", "counts": "counts", "adc": "counts", "raw": "counts"}
    | {"a.u.": "a.u.", "au": "a.u.", "hz": "Hz", "g": "g", "deg": "deg", "n": "N", "nm": "Nm", "%": "%"}
)

_HERE = "palp_core.palpation.identification.emg"
_READERS = {
    ".csv": f"{_HERE}.files_csv:read_csv",
    ".tsv": f"{_HERE}.files_csv:read_csv",
    ".txt": f"{_HERE}.files_csv:read_csv",
    ".npz": f"{_HERE}.files_npz:read_npz",
    ".edf": f"{_HERE}.files_edf:read_edf",
    ".bdf": f"{_HERE}.files_edf:read_edf",
    ".xdf": f"{_HERE}.files_xdf:read_xdf",
    ".xdfz": f"{_HERE}.files_xdf:read_xdf",
    ".mcap": f"{_HERE}.files_bag:read_bag",
}


def _readers() -> dict[str, str]:
    """Return what reads which suffix: palp's own, then what packages publish (``palp.emg_readers``)."""
    others = {f".{name.lower().lstrip('.')}": where for name, where in published(EMG_READERS).items()}
    return {**_READERS, **{suffix: others[suffix] for suffix in others if suffix not in _READERS}}


def is_recording(path: Path) -> bool:
    """Return whether a path is a file of a known kind, or a bag's folder."""
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
        raise PalpError(
            f"{path}: cannot read '{path.suffix}' files; convert it to one of {' '.join(readers)}"
        )
    with catch_foreign(str(path), PalpError):
        if suffix != ".mcap":
            check_regular(path, LARGEST_BYTES)
        found = import_foreign(readers[suffix], str(path), PalpError)(path)
    if not isinstance(found, EmgFile):  # of another package's reader
        raise PalpError(f"{path}: {readers[suffix]} returned no EmgFile but {type(found).__name__}")
    if not found.columns:
        raise PalpError("; ".join([f"{path}: holds no column of numbers", *found.notes]))
    return found


def plain_unit(text: str) -> str:
    """Return a unit in one spelling, or as it is where it is not a known one.

    Both characters for micro are ``u``, and so is what UTF-8 read as Latin-1 makes of them.

    >>> [plain_unit(one) for one in ("\u00b5V", "\u03bcV", "\u00c2\u00b5V", "microvolts", "Nm")]
    ['uV', 'uV', 'uV', 'uV', 'Nm']
    """
    text = text.strip().strip("()[]\"'").strip()
    for micro in ("\u00c2\u00b5", "\u00ce\u00bc", "\u00b5", "\u03bc"):
        text = text.replace(micro, "u")
    return _SPELLINGS.get(text.lower(), text)


def is_unit(text: str) -> bool:
    """Return whether a text is a known unit."""
    return plain_unit(text) in _SPELLINGS.values()


def split_unit(heading: str) -> tuple[str, str]:
    """Split a heading into name and unit; other brackets stay.

    >>> split_unit("FDS (uV)"), split_unit("fds_v"), split_unit("EDC (left)"), split_unit("X, s")
    (('FDS', 'uV'), ('fds_v', 'V'), ('EDC (left)', ''), ('X', 's'))
    """
    heading = heading.strip().strip("\"'").strip()
    for apart in (r"(.*?)[\s,]*[(\[]\s*([^()\[\]]{1,12})\s*[)\]]", r"(.*), *([^ ,]{1,12})"):
        found = re.fullmatch(apart, heading)
        if found and is_unit(found[2]):
            return found[1].strip() or heading, plain_unit(found[2])
    suffix = re.search(r"_((?:[nu\u00b5\u03bcm]|\u00c2\u00b5|\u00ce\u00bc)?[vs])$", heading, re.IGNORECASE)
    voltage = suffix and suffix[1][-1] in "vV"
    if suffix and (voltage or is_time(heading)):
        return heading, plain_unit(suffix[1])
    return heading, ""


_TIME = re.compile(
    r"(?:^|[\W_])(?:t|zeit|temps|tiempo|tempo|sec|secs|seconds|clock|elapsed)(?:$|[\W_])|time|stamp",
    re.IGNORECASE,
)


def is_time(name: str) -> bool:
    """Return whether a name is that of a time."""
    return _TIME.search(name) is not None
