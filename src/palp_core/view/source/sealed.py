"""Which folders keep what nobody is to know yet: of a blinded run, until it is unsealed.

Either is enough: a key that lies there unopened, or the run's own note of a node that was blinded, for the
key may lie elsewhere.
"""

from __future__ import annotations

import json
import os
from functools import lru_cache
from pathlib import Path

from palp_core.whole_file import read_whole

SEALED = ".sealed"
"""Of a file that keeps what nobody is to know yet; opened, a ``.json`` of the same name lies beside it."""
OPENED = "key.json"
"""Lies in the folder of a blinded run once it is unsealed, wherever the key was."""
NOTES = ("run.json", ".next_run.json")
"""What a run says of itself: among it the parameters of its nodes."""


def sealed_within(folder: Path) -> Path | None:
    """Return a folder in which something is sealed: this one, one below it, or a run's that it is part of.

    Args:
        folder: Where to look, resolved; None is returned if nothing is sealed there.
    """
    for above in folder.parents:
        if _is_of_blinded_run(above):
            return above
    for place, folders, files in os.walk(folder):
        folders.sort()
        keys = (name for name in files if name.endswith(SEALED))
        opened = {name for name in files if name.endswith(".json")}
        if any(f"{name.removesuffix(SEALED)}.json" not in opened for name in keys):
            return Path(place)
        if OPENED not in opened and any(_tells_blind(Path(place, name)) for name in NOTES if name in files):
            return Path(place)
    return None


def _is_of_blinded_run(folder: Path) -> bool:
    return not (folder / OPENED).exists() and any(_tells_blind(folder / name) for name in NOTES)


def _tells_blind(note: Path) -> bool:
    """Tell whether a run's note has a node that was blinded; one that may not be read may have."""
    try:
        entry = note.stat()
        return _says_blind(note, entry.st_mtime_ns, entry.st_size)
    except PermissionError:
        return True
    except OSError:
        return False


@lru_cache(maxsize=1024)
def _says_blind(note: Path, _changed_ns: int, _size: int) -> bool:
    """Read a note once in each of its states: a page looks twice a second."""
    try:
        params = json.loads(read_whole(note))["params"]
        return any(one.get("blind") is True for one in params.values())
    except (ValueError, KeyError, AttributeError, TypeError, RecursionError):  # no note of a run
        return False
