"""Files that appear under their name only when they are complete: whole, or not at all."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import msgspec

PRIVATE = 0o600
"""The mode of what is this user's alone."""


@contextlib.contextmanager
def whole_file(path: Path, *, mode: int = 0o666, durable: bool = False) -> Iterator[BinaryIO]:
    """Open a file for writing; it takes its name, from an older file if there is one, at the block's end.

    Of a link, what it leads to is replaced. A pipe or a device, as ``/dev/stdout``, is written as it is.

    Args:
        path: Where, in a folder that exists. After an error what was there before is there still.
        mode: Who may read and write it, less the umask, from its first byte on.
        durable: It is on the disk at the end, and so is its name: a power cut takes neither.

    Raises:
        OSError: It cannot be written.
    """
    if path.exists() and not path.is_file():
        with path.open("wb") as file:
            yield file
        return
    path = path.resolve()
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    part.unlink(missing_ok=True)  # of a process of this number, long ago
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    if durable:
        _sync_folder(path.parent)


def write_whole(path: Path, content: str | bytes, *, mode: int = 0o666, durable: bool = False) -> None:
    """Write a file; text becomes UTF-8. The arguments are those of :func:`whole_file`.

    Raises:
        OSError: It cannot be written.
    """
    with whole_file(path, mode=mode, durable=durable) as file:
        file.write(content.encode() if isinstance(content, str) else content)


def write_json(path: Path, value: Any, *, mode: int = 0o666) -> None:
    """Write a value as indented JSON; NaN becomes null. The mode is that of :func:`whole_file`.

    Raises:
        OSError: It cannot be written.
    """
    write_whole(path, msgspec.json.format(msgspec.json.encode(value), indent=1) + b"\n", mode=mode)


def open_private(path: str, flags: int) -> int:
    """Open a file, as the ``opener`` of ``open``: a new one is this user's alone, and no link is followed.

    Raises:
        OSError: It cannot be opened, or is a link.
    """
    return os.open(path, flags | os.O_NOFOLLOW | os.O_CLOEXEC, PRIVATE)


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
