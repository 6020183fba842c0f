"""A session's folder: what a session writes there, whether one is there already, the link to the latest."""

import contextlib
import fcntl
import os
import re
import shutil
from pathlib import Path

from palp_core.errors import PalpError

TABLE = "trials.csv"
SWEEPS = "sweeps"
RUN = "run.json"
NEXT_RUN = ".next_run.json"
OWN_FILES = (
    TABLE,
    SWEEPS,
    "primitives.json",
    RUN,
    "result.json",
    "report.html",
    "charts",
    "noise.yaml",
    "repeatability.json",
)
LATEST = "latest"

_LONGEST_LINE = 1 << 20

_NAMED_BY_TIME = re.compile(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d")


def refuse_occupied(
    folder: Path,
    ways_on: str = "give this one another folder, out:=NAME, or let it replace that one, overwrite:=true",
) -> None:
    """Refuse a folder that holds a session; one that ended before its first palpation is none.

    Args:
        folder: Where a session is to go.
        ways_on: What to do about it.

    Raises:
        PalpError: It does, or what lies there cannot be looked at.
    """
    try:
        found = [name for name in OWN_FILES if _tells(folder / name)]
    except OSError as error:
        raise cannot_write(folder, error) from error
    if found:
        raise PalpError(
            f"'{folder}' holds a session already ({', '.join(found)}), and nothing is overwritten unasked: "
            f"{ways_on}"
        )


def cannot_write(folder: Path, error: OSError) -> PalpError:
    """Return what to say when a session cannot begin in a folder."""
    return PalpError(f"cannot write the record to '{folder}': {error}; choose another out:=")


def _tells(path: Path) -> bool:
    """Tell whether a file or folder of a session says anything: more than that a session began."""
    if not os.path.lexists(path) or path.name == RUN:
        return False
    if path.name == SWEEPS:
        return any(path.iterdir())
    if path.name == TABLE:
        if not path.is_file():
            return True
        with path.open("rb") as file:
            file.readline(_LONGEST_LINE)
            return bool(file.read(1))
    return True


def is_being_written(folder: Path) -> bool:
    """Tell whether a session has the folder right now."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def take_over(folder: Path) -> None:
    """Remove what an earlier session wrote there, and let the note of the present run take its name.

    Other files stay.

    Raises:
        OSError: Something cannot be removed.
    """
    for name in OWN_FILES:
        path = folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    if (folder / NEXT_RUN).exists():
        (folder / NEXT_RUN).replace(folder / RUN)


def link_latest(folder: Path) -> None:
    """Let ``latest`` beside a folder that is named by its time lead there, unless that is no link of ours."""
    link = folder.parent / LATEST
    if not _NAMED_BY_TIME.fullmatch(folder.name) or (link.exists() and not link.is_symlink()):
        return
    fresh = link.with_name(f".{LATEST}.{os.getpid()}")
    with contextlib.suppress(OSError):  # a file system without links: it is a convenience
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(folder.name, target_is_directory=True)
        fresh.replace(link)
