"""Expensive set-ups kept on disk under a hash of what they depend on: the inputs and this package's source.

Entries are files of arrays in ``$PALP_CACHE``, else ``$XDG_CACHE_HOME/palp``, else ``~/.cache/palp``. They
are written next to their place and renamed into it, so a reader sees a whole entry or none. A lock per entry,
held by the kernel and thus freed when its holder dies, keeps two processes from computing the same thing. A
damaged entry is computed again; a place that cannot be written to is done without. To clear the cache, remove
the folder.
"""

import contextlib
import hashlib
import json
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.user_folders import cache_folder
from palp_core.whole_file import locked_path, whole_file

Arrays = dict[str, np.ndarray[Any, np.dtype[Any]]]

_LAYOUT = 1  # changes when entries are laid out differently
_UNREADABLE = (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile)


def cached(kind: str, inputs: Mapping[str, float | int | str], compute: Callable[[], Arrays]) -> Arrays:
    """Return ``compute()``, from the cache if the same inputs and code have been there before."""
    path = cache_folder() / f"{kind}-{_digest(kind, inputs)}.npz"
    found = _load(path)
    if found is not None:
        return found
    with _locked(path.with_suffix(".lock")):
        found = _load(path)  # somebody else may have finished while we waited
        if found is None:
            found = compute()
            _store(path, found)
    return found


def _digest(kind: str, inputs: Mapping[str, float | int | str]) -> str:
    exact = {k: float(v).hex() if isinstance(v, float) else v for k, v in sorted(inputs.items())}
    text = json.dumps([_LAYOUT, kind, exact])
    return hashlib.sha256(text.encode() + code()).hexdigest()[:32]


@cache
def code() -> bytes:
    """Return a digest of this package's source: a changed model never reads an old result.

    The ball's forms belong to it.
    """
    total = hashlib.sha256()
    folder = Path(__file__).parent
    for path in (*sorted(folder.glob("*.py")), folder.parent / "tip.py"):
        total.update(path.name.encode() + b"\0" + path.read_bytes())
    return total.digest()


def _load(path: Path) -> Arrays | None:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except _UNREADABLE:
        return None


def _store(path: Path, arrays: Arrays) -> None:
    with contextlib.suppress(OSError), whole_file(path, durable=True) as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the lock of an entry; without one where nothing can be written."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked_path(path, os.O_RDWR | os.O_CREAT))
        yield
