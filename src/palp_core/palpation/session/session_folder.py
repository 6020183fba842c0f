"""A session's folder: what a session writes there, whether one is there already, the link to the latest."""

import contextlib
import fcntl
import os
import re
import shutil
from pathlib import Path

from palp_core.errors import PalpError
from palp_core.whole_file import is_locked

TABLE = "trials.csv"
SWEEPS = "sweeps"
RUN = "run.json"
SHEET = "session.yaml"
RESULT = "result.json"
NEXT_RUN = ".next_run.json"
OPENED = "key.json"
"""Which code was which phantom, of a session with a person that was unsealed."""

CHECKPOINT = "checkpoint"
"""Where an unfinished session can go on, as the launch file says."""

INTERRUPTED = "interrupted"
"""Has a folder per interruption: what had been made of the trial that was under way."""

OWN_FILES = (
    TABLE,
    SWEEPS,
    "primitives.json",
    "audit.csv",
    RUN,
    SHEET,
    RESULT,
    "report.html",
    "charts",
    "noise.yaml",
    CHECKPOINT,
    INTERRUPTED,
)
LATEST = "latest"
REPLACED = ".replaced"
"""Where a session waits that is to be replaced, until the other one has a row."""

_LONGEST_LINE = 1 << 20

_NAMED_BY_TIME = re.compile(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d")


def refuse_occupied(
    folder: Path,
    ways_on: str = "give this one another folder, out:=NAME, or let it replace that one, overwrite:=true",
    named_by: str = "out:=",
) -> None:
    """Refuse a folder that holds a session; one that ended before its first palpation is none."""
    try:
        found = [name for name in (*OWN_FILES, REPLACED) if _has_content(folder / name)]
    except OSError as error:
        raise cannot_write(folder, error, named_by) from error
    if found:
        raise PalpError(
            f"'{folder}' holds a session already ({', '.join(found)}), and nothing is overwritten unasked: "
            f"{ways_on}"
        )


def cannot_write(folder: Path, error: OSError, named_by: str = "out:=") -> PalpError:
    """Return the error of a session that cannot begin in a folder that was given with ``named_by``."""
    return PalpError(f"cannot write the record to '{folder}': {error}; choose another {named_by}")


def _has_content(path: Path) -> bool:
    """Return whether a file or folder of a session holds more than that a session began."""
    if not os.path.lexists(path) or path.name == RUN:
        return False
    if path.name == CHECKPOINT:  # may be of a session that has no palpation yet
        return not (path.parent / TABLE).exists()
    if path.name == SWEEPS:
        return any(path.iterdir())
    if path.name == TABLE:
        if not path.is_file():
            return True
        with path.open("rb") as file:
            file.readline(_LONGEST_LINE)
            return bool(file.read(1))
    return True


class FolderLock:
    """Keeps other sessions out of the folder that one writes into; two would mix their rows."""

    def __init__(self) -> None:
        self._descriptor = -1

    def take(self, folder: Path, named_by: str = "out:=") -> None:
        """Take the folder until :meth:`release`, or the end of the process."""
        self._descriptor = os.open(folder, os.O_RDONLY)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise PalpError(
                f"another session is writing its record into '{folder}'; choose another {named_by}"
            ) from None

    def release(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
        self._descriptor = -1


def is_being_written(folder: Path) -> bool:
    return is_locked(folder.resolve())


def set_aside(folder: Path) -> Path:
    """Return a new folder for what an interruption cut off: ``interrupted/1``, ``interrupted/2`` ..."""
    place = folder / INTERRUPTED
    kept = place / str(1 + sum(1 for _ in place.glob("*")))
    kept.mkdir(parents=True)
    return kept


def refuse_input(folder: Path, path: Path, what: str) -> None:
    """Refuse to replace a session that something is to be read from."""
    inside = [folder.resolve() / name for name in OWN_FILES]
    if any(path.resolve().is_relative_to(one) for one in inside):
        raise PalpError(
            f"{what} is in '{folder}', whose session is to be replaced; move it elsewhere, or choose another"
            " folder"
        )


def take_over(folder: Path) -> None:
    """Put an earlier session aside, and let the note of the present run take its name. Other files stay."""
    found = [name for name in OWN_FILES if _has_content(folder / name)]
    if found and not any((folder / name).exists() for name in (TABLE, RUN)):
        raise PalpError(
            f"'{folder}' holds {', '.join(found)}, but neither {TABLE} nor {RUN}; choose another folder"
        )
    if found:
        forget_replaced(folder)
        (folder / REPLACED).mkdir()
    for name in OWN_FILES:
        path = folder / name
        if found and os.path.lexists(path):
            path.rename(folder / REPLACED / name)
        else:
            _remove(path)
    if (folder / NEXT_RUN).exists():
        (folder / NEXT_RUN).replace(folder / RUN)


def forget_replaced(folder: Path) -> None:
    """Remove the session that was put aside: the other one has begun."""
    _remove(folder / REPLACED)


def restore_replaced(folder: Path) -> None:
    """Let the session that was put aside have its folder again, if the other one has no palpation."""
    aside = folder / REPLACED
    if aside.is_dir() and not _has_content(folder / TABLE):
        for name in OWN_FILES:
            _remove(folder / name)
        for path in aside.iterdir():
            path.rename(folder / path.name)
        aside.rmdir()


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def link_latest(folder: Path) -> None:
    """Let ``latest`` next to a folder named by its time lead there, unless that is no link of ours."""
    link = folder.parent / LATEST
    if not _NAMED_BY_TIME.fullmatch(folder.name) or (link.exists() and not link.is_symlink()):
        return
    fresh = link.with_name(f".{LATEST}.{os.getpid()}")
    with contextlib.suppress(OSError):  # a file system without links: it is a convenience
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(folder.name, target_is_directory=True)
        fresh.replace(link)
