"""Which folders keep what nobody is to know yet: of a blinded run, until it is unsealed.

Told by three things, each enough: a key that lies there unopened; the run's own note of a node that was
blinded, for the key may lie elsewhere; a table with numbers that stand for depths, for it may have been
copied alone, and whoever compares them with the estimates beside them knows what was right.
"""

from __future__ import annotations

import csv
import json
import os
from functools import lru_cache
from itertools import islice
from pathlib import Path
from stat import S_ISREG

from palp_core.sealing import stands_for_a_depth
from palp_core.whole_file import read_whole

SEALED = ".sealed"
"""Of a file that keeps what nobody is to know yet; opened, a ``.json`` of the same name lies beside it."""
OPENED = "key.json"
"""Lies in the folder of a blinded run once it is unsealed, wherever the key was."""
NOTES = ("run.json", ".next_run.json")
"""What a run says of itself: among it the parameters of its nodes."""

DEPTH, FIRST_ROWS, FIRST_BYTES = "depth_m", 20, 64 << 10
"""The column of a table in which a number may stand for a depth, and how much of it is looked at."""


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
        if OPENED not in opened and (
            any(_tells_blind(Path(place, name)) for name in NOTES if name in files)
            or any(_has_codes(Path(place, name)) for name in files if name.endswith(".csv"))
        ):
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


def _has_codes(table: Path) -> bool:
    """Tell whether numbers stand for depths in a table; one that may not be read is not served either."""
    try:
        entry = table.stat()
        return S_ISREG(entry.st_mode) and _tells_codes(table, entry.st_mtime_ns, entry.st_size)
    except OSError:
        return False


@lru_cache(maxsize=4096)
def _tells_codes(table: Path, _changed_ns: int, _size: int) -> bool:
    with table.open("rb") as file:
        lines = file.read(FIRST_BYTES).decode(errors="replace").splitlines()
    try:
        return any(_is_code(row.get(DEPTH)) for row in islice(csv.DictReader(lines), FIRST_ROWS))
    except csv.Error:  # no table of a session
        return False


def _is_code(cell: object) -> bool:
    try:
        return isinstance(cell, str) and stands_for_a_depth(float(cell))
    except ValueError:
        return False


@lru_cache(maxsize=1024)
def _says_blind(note: Path, _changed_ns: int, _size: int) -> bool:
    """Read a note once in each of its states: a page looks twice a second."""
    try:
        params = json.loads(read_whole(note))["params"]
        return any(one.get("blind") is True for one in params.values())
    except (ValueError, KeyError, AttributeError, TypeError, RecursionError):  # no note of a run
        return False
