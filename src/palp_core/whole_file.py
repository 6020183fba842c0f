"""Whole files: they appear under their name only when they are complete, and none is read that has no end."""

import contextlib
import errno
import fcntl
import json
import os
import stat
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import msgspec

PRIVATE = 0o600
"""The mode of what is this user's alone."""

LARGEST_BYTES = 128 << 20
"""What is read of one file, if nothing else is said."""


def why_not(error: OSError, path: str | Path) -> str:
    """Return in words why a file cannot be read, and where a relative path was looked for that leads nowhere.

    >>> why_not(FileNotFoundError(2, "No such file or directory"), "/gone/scene.yaml")
    'No such file or directory'
    """
    said = error.strerror or str(error)
    if isinstance(error, FileNotFoundError) and not Path(path).is_absolute():
        return f"{said} (looked in {Path.cwd()})"
    return said


@contextlib.contextmanager
def whole_file(
    path: Path, *, mode: int = 0o666, durable: bool = False, new: bool = False
) -> Iterator[BinaryIO]:
    """Open a file for writing; it takes its name, from an older file if there is one, at the block's end.

    Of a link, what it leads to is replaced. A pipe or a device, as ``/dev/stdout``, is written as it is.

    Args:
        path: Where, in a folder that exists. After an error what was there before is there still.
        mode: Who may read and write it, less the umask, from its first byte on.
        durable: It is on the disk at the end, and so is its name: a power cut takes neither.
        new: It takes the name from no other file: of several processes, one writes it.

    Raises:
        OSError: It cannot be written, or is there and is to be new.
    """
    if path.exists() and not path.is_file():
        with path.open("wb") as file:
            yield file
        return
    path = path.resolve()
    part = path.with_name(f".{path.name}.{threading.get_native_id()}.part")
    part.unlink(missing_ok=True)  # of a thread of this number, long ago
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
        if new:
            path.hardlink_to(part)
        else:
            part.replace(path)
    except OSError as error:
        error.filename = error.filename or str(path)  # a full disk names no file
        raise
    finally:
        part.unlink(missing_ok=True)
    if durable:
        _sync_folder(path.parent)


def write_whole(
    path: Path, content: str | bytes, *, mode: int = 0o666, durable: bool = False, new: bool = False
) -> None:
    """Write a file; text becomes UTF-8, a character that has none, as of a foreign file name, its escape.

    The other arguments are those of :func:`whole_file`.

    Raises:
        OSError: It cannot be written.
    """
    with whole_file(path, mode=mode, durable=durable, new=new) as file:
        file.write(content.encode(errors="backslashreplace") if isinstance(content, str) else content)


def write_json(path: Path, value: Any, *, mode: int = 0o666) -> None:
    """Write a value as indented JSON; NaN becomes null. The mode is that of :func:`whole_file`.

    Raises:
        OSError: It cannot be written.
    """
    write_whole(path, encode_json(value, indent=1) + b"\n", mode=mode)


def encode_json(value: Any, indent: int = 0) -> bytes:
    r"""Return a value as JSON; NaN and infinity, which JSON lacks, become null.

    >>> encode_json({"file": "t\udcff.csv", "rate_hz": float("nan")})
    b'{"file": "t\\udcff.csv", "rate_hz": null}'
    """
    try:
        data = msgspec.json.encode(value)
        return msgspec.json.format(data, indent=indent) if indent else data
    except UnicodeEncodeError:  # the name of a file that is not UTF-8
        plain = json.loads(json.dumps(msgspec.to_builtins(value)), parse_constant=lambda _: None)
        return json.dumps(plain, indent=indent or None).encode()


@contextlib.contextmanager
def locked_path(path: Path, flags: int = os.O_RDONLY) -> Iterator[int]:
    """Let one process at a time look at a file or folder and write what follows from it.

    Args:
        path: What is locked until the block ends.
        flags: By which it is opened; the block has its descriptor.

    Raises:
        OSError: It cannot be opened.
    """
    descriptor = os.open(path, flags, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield descriptor
    finally:
        os.close(descriptor)


def is_locked(path: Path) -> bool:
    """Tell whether a process has locked a file or folder; its lock ends with it."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)  # shared: two who ask do not see each other
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def append_whole(path: Path, text: str, flags: int = os.O_CREAT, heading: str = "") -> None:
    """Append lines whole, or leave the file as it was: a full disk takes a part of what it is given.

    Args:
        path: The file; a line that a process did not finish stays one of its own.
        text: The lines.
        flags: 0 refuses to make the file, ``os.O_EXCL`` with ``os.O_CREAT`` one that is there.
        heading: Goes before them in a file that is empty.

    Raises:
        OSError: They cannot be written.
    """
    with locked_path(path, os.O_RDWR | os.O_APPEND | flags) as descriptor:
        size = os.fstat(descriptor).st_size
        cut_short = size > 0 and os.pread(descriptor, 1, size - 1) != b"\n"
        rest = memoryview(("\n" * cut_short + heading * (size == 0) + text).encode())
        try:
            while rest:
                rest = rest[os.write(descriptor, rest) :]
        except OSError:
            os.ftruncate(descriptor, size)
            raise


def check_regular(path: str | Path, largest: int | None = None) -> None:
    """Refuse what a name may lead to and what has no end: a pipe, a device, a folder, a file without measure.

    Args:
        path: What is to be read; a link is followed.
        largest: In bytes; None: as large as it likes.

    Raises:
        OSError: It is none that is to be read, in words as ``strerror``.
    """
    found = Path(path).stat()
    if not stat.S_ISREG(found.st_mode):
        kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
        kind = kinds.get(stat.S_IFMT(found.st_mode), "a device")
        raise OSError(errno.EINVAL, f"it is {kind}, not a file", str(path))
    if largest is not None and found.st_size > largest:
        raise OSError(errno.EFBIG, f"it has more than {_size(largest)}", str(path))


def read_whole(path: str | Path, largest: int = LARGEST_BYTES) -> bytes:
    """Return what is in a regular file.

    Args:
        path: Which; a link is followed.
        largest: In bytes; one that has more is refused before it is read.

    Raises:
        OSError: It cannot be read, is no regular file or too large; ``strerror`` says it in words.
    """
    check_regular(path, largest)
    with Path(path).open("rb") as file:
        data = file.read(largest + 1)  # it may grow, or state no size at all, as in /proc
    if len(data) > largest:
        raise OSError(errno.EFBIG, f"it has more than {_size(largest)}", str(path))
    return data


def begins_with(path: str | Path, start: bytes) -> bool:
    """Tell whether a regular file begins with some bytes; no pipe, device or unreadable file does.

    Args:
        path: Which; a link is followed.
        start: The bytes.
    """
    try:
        check_regular(path)
        with Path(path).open("rb") as file:
            return file.read(len(start)) == start
    except OSError:
        return False


def _size(count: int) -> str:
    return f"{count >> 20} MiB" if count >= 1 << 20 else f"{count >> 10} KiB"


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
