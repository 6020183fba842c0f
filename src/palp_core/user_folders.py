"""Where the files of this user are, by the environment.

https://specifications.freedesktop.org/basedir-spec/, with a variable of palp's own before each of it.
"""

import errno
import functools
import hashlib
import os
import stat
import sys
from pathlib import Path

LONGEST_RUNTIME_FOLDER = (
    44  # bytes; a socket's path holds 107: this, a run's name (25), a node's (32), ".pub", slashes
)
LEAST_ROOM = 512 << 10
"""What a run takes at its start: with nodes of many parameters a third of it."""
SHORT = Path("/tmp")  # not tempfile's choice, which is the folder that is too long


def keys_folder() -> Path:
    """Return the folder of this user's keys: ``$PALP_KEYS``, else ``~/.config/palp/keys`` or XDG's."""
    return _folder("PALP_KEYS", "XDG_CONFIG_HOME", ".config", "palp/keys")


def cache_folder() -> Path:
    """Return the folder of what can be computed again: ``$PALP_CACHE``, else ``~/.cache/palp`` or XDG's."""
    return _folder("PALP_CACHE", "XDG_CACHE_HOME", ".cache", "palp")


def _folder(own: str, shared: str, default: str, name: str) -> Path:
    if folder := os.environ.get(own):
        return Path(folder)
    return Path(os.environ.get(shared) or Path.home() / default) / name


def runtime_folder() -> Path:
    """Return the folder of this user's run directories; the same for every command in the same environment.

    A setting that cannot be followed is said on stderr. One whose path is too long for a socket still has its
    own graphs: a short folder stands for it, named after it.
    """
    own = f"palp-{os.getuid()}"
    for variable, name in (("XDG_RUNTIME_DIR", "palp"), ("TMPDIR", own)):
        folder = os.environ.get(variable)
        if not folder:
            continue
        if not os.access(folder, os.W_OK | os.X_OK):
            _remark(f"{variable}={folder} is no folder that this user can write to, and is not used")
            continue
        base = Path(folder).absolute() / name
        if len(os.fsencode(base)) <= LONGEST_RUNTIME_FOLDER:
            return base
        digest = hashlib.blake2b(os.fsencode(Path(folder).resolve()), digest_size=5).hexdigest()
        short = SHORT / f"{own}-{digest}"  # not in TMPDIR: a command that has another must find it, too
        _remark(
            f"{variable}={folder} is too long for the paths of sockets: graphs run from it are in {short}; "
            f"set {variable} to a folder of at most {LONGEST_RUNTIME_FOLDER - len(name) - 1} bytes"
        )
        return short
    return SHORT / own


def folder_mistake(folder: Path) -> str | None:
    """Return why a folder may hold what another user has put there, as in /tmp anybody can; None if not.

    A link is not followed: it leads where its owner likes.

    Raises:
        FileNotFoundError: There is nothing.
    """
    found = folder.lstat()
    kind = "a symbolic link" if stat.S_ISLNK(found.st_mode) else "a file"
    if not stat.S_ISDIR(found.st_mode):
        return f"{folder} is not a folder of this user but {kind}"
    if found.st_uid != os.getuid():
        return f"{folder} is not a folder of this user but of user {found.st_uid}"
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"{folder} can be written to by others (mode {stat.S_IMODE(found.st_mode):03o})"
    return None


def own_folder(folder: Path) -> str | None:
    """Make a folder that none but this user can enter, or shut one that is there already.

    Returns:
        Why it is not this user's, as :func:`folder_mistake` does; None if it is.

    Raises:
        OSError: It cannot be made.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    found = folder.lstat()
    if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid():
        folder.chmod(0o700)
    return folder_mistake(folder)


def room_mistake(folder: Path) -> str | None:
    """Return why a run has no room in a folder of runs, and what to do; None if it has.

    It is tried: a quota or a limit on the size of files says nothing before.
    """
    import tempfile

    try:
        with tempfile.TemporaryFile(dir=folder) as trial:
            os.posix_fallocate(trial.fileno(), 0, LEAST_ROOM)
    except OSError as error:
        unknown = error.errno in (errno.EOPNOTSUPP, errno.EINVAL)  # not a question for this file system
        return None if unknown else no_room(folder, error)
    return None


def no_room(folder: Path, error: OSError) -> str:
    """Return what to say where the folder of runs takes no more."""
    return (
        f"{folder}: {error.strerror}: a run keeps its sockets, record and logs there, {LEAST_ROOM >> 10} KiB "
        "at least; make room on that disk, or set XDG_RUNTIME_DIR to a folder of your own on another one"
    )


@functools.cache
def _remark(text: str) -> None:
    """Say it once in a process, beside what the command prints."""
    sys.stderr.write(f"palp: {text}\n")
