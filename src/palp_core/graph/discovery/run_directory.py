"""The folder of a run: sockets, logs, and ``graph.json``, by which the command line finds a running graph."""

import contextlib
import fcntl
import logging
import os
import re
import shutil
import stat
import tempfile
from pathlib import Path

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.clock import unix_ns
from palp_core.graph.description.launch_file import find_workspace
from palp_core.graph.messages.topic import Topic
from palp_core.graph.node.spec import NAME
from palp_core.user_folders import folder_mistake, no_room, own_folder, room_mistake, runtime_folder
from palp_core.whole_file import PRIVATE, is_locked, locked_path, open_private, write_json, write_whole

_log = logging.getLogger("palp.supervisor")
KEEP_ENDED = 20
KEEP_ENDED_BYTES = 256 << 20
"""Of all ended runs together, but for the latest one, which is kept whatever it takes."""
RECORD = "graph.json"


END_ASKED = "end_asked_by"
CLAIM = "name"
"""Holds the name that a starting graph was given, until its record has it."""


class NodeEntry(msgspec.Struct, frozen=True):
    name: str
    run: str
    pid: int
    publish: str
    serve: str


class RunRecord(msgspec.Struct, frozen=True):
    """What ``graph.json`` holds: which graph runs, and where everything of it is.

    Attributes:
        nodes: Those with a place in the run directory.
        launched_from: The folder it was launched from, as :func:`present_folder` returns it.
        view: ``module:function`` that fills the launch file's own page of ``palp view``; "" if it has none.
    """

    graph: str
    file: str
    clock: str
    pid: int
    start_unix_ns: int
    serve: str
    nodes: list[NodeEntry]
    topics: list[Topic]
    listen: str = ""
    workspace: str = ""
    launched_from: str = ""
    view: str = ""

    @property
    def id(self) -> str:
        """What no other run of this user has: the name of its run directory."""
        return Path(self.serve.removeprefix("ipc://")).parent.name

    def __str__(self) -> str:
        return f"{self.graph} (id {self.id}, pid {self.pid}, {self.workspace or self.launched_from})"


class _NotOwn(GraphError):
    """The folder of all runs may be another's work."""

    def __init__(self, mistake: str) -> None:
        super().__init__(f"{mistake}; set XDG_RUNTIME_DIR to a folder of your own")


class RunDirectory:
    """A folder only its owner can enter; a new one for each run, locked while the run lasts."""

    def __init__(self, graph: str, name: str | None = None) -> None:
        base = runtime_folder()
        self._start_unix_ns, self._launched_from = unix_ns(), present_folder()
        try:
            if (mistake := own_folder(base)) is not None:
                raise _NotOwn(mistake)
            _prune()
            if (mistake := room_mistake(base)) is not None:
                raise GraphError(mistake)
            prefix = re.sub(r"[^A-Za-z0-9_]", "_", graph[:16])
            with locked_path(base):  # of two launches with one name, the later finds the other's claim
                if name is not None:
                    check_free(name)
                self.path = Path(tempfile.mkdtemp(prefix=f"{prefix}-", dir=base))
                self._lock = os.open(self.path, os.O_RDONLY)
                fcntl.flock(self._lock, fcntl.LOCK_EX)
                (self.path / "log").mkdir(mode=0o700)
                if name is not None:
                    write_whole(self.path / CLAIM, name)
        except OSError as error:
            raise GraphError(
                f"no run directory in {base}: {error.strerror}; set XDG_RUNTIME_DIR to a folder of your own"
            ) from error

    def log(self, node: str) -> Path:
        return self.path / "log" / f"{node}.log"

    def end_asked_by(self) -> str:
        """Return what has asked the graph to end, as it has written here; "" if nothing has."""
        return _text_of(self.path / END_ASKED)

    def record(
        self, graph: str, file: str, clock: str, serve: str, nodes: list[NodeEntry], topics: list[Topic]
    ) -> RunRecord:
        start_ns, launched_from = self._start_unix_ns, self._launched_from
        return RunRecord(
            graph, file, clock, os.getpid(), start_ns, serve, nodes, topics, launched_from=launched_from
        )

    def write(self, record: RunRecord) -> None:
        """Make the graph visible to the command line.

        A full disk ends no graph that is visible already; a warning is logged.
        """
        try:
            write_json(self.path / RECORD, record, mode=PRIVATE)
        except OSError as error:
            text = no_room(self.path, error)
            if not (self.path / RECORD).exists():
                raise GraphError(text) from error
            _log.warning("%s. The graph continues; other commands see its former state", text)

    def remove(self) -> None:
        shutil.rmtree(self.path, ignore_errors=True)
        self.release()

    def release(self) -> None:
        """Leave the folder with logs and record to later runs, which remove it when it is one of many."""
        if self._lock >= 0:
            self._remove_sockets()
            os.close(self._lock)
        self._lock = -1

    def _remove_sockets(self) -> None:
        """Remove what is of no use once all of the run's processes have ended."""
        with contextlib.suppress(OSError):
            for entry in self.path.iterdir():
                if entry.is_socket():
                    entry.unlink()


def _text_of(path: Path) -> str:
    """Return what a file of a run directory holds; "" if it is not there, or goes with its run just now."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""


def present_folder() -> str:
    """Return the folder one is in, as graphs belong to it: the nearest above with ``nodes/``, if any."""
    try:
        return str(find_workspace(Path.cwd() / "file"))
    except FileNotFoundError:  # it was removed
        return ""


def read_record(folder: Path) -> RunRecord | None:
    """Return the record of a run directory; None where there is none, or it cannot be read."""
    try:
        with open(folder / RECORD, "rb", opener=open_private) as file:
            return msgspec.json.decode(file.read(), type=RunRecord)
    except (OSError, msgspec.MsgspecError):
        return None


def runs() -> list[tuple[Path, RunRecord, bool]]:
    """Return every run of this user with a record: folder, record, whether it lives; the latest first."""
    found = [(folder, record, is_locked(folder)) for folder in _folders() if (record := read_record(folder))]
    return sorted(found, key=lambda run: -run[1].start_unix_ns)


def running() -> list[RunRecord]:
    """Return the running graphs of this user, the latest first."""
    return [record for _, record, lives in runs() if lives]


def check_free(name: str) -> None:
    if NAME.fullmatch(name) is None:
        raise GraphError(
            f"'{name}' is not a graph's name; use letters, digits and _, a letter first, at most 32"
        )
    for folder in _folders():
        if not is_locked(folder):
            continue
        if (record := read_record(folder)) is not None:
            if record.graph == name:
                raise GraphError(f"a graph of that name is running: {record}; choose another name")
        elif _text_of(folder / CLAIM) == name:
            raise GraphError(
                f"a graph of that name is starting: {name} (id {folder.name}); choose another name"
            )


def _folders() -> list[Path]:
    base = runtime_folder()
    try:
        mistake = folder_mistake(base)
    except FileNotFoundError:
        return []
    if mistake is not None:
        raise _NotOwn(mistake)
    return [folder for folder in base.iterdir() if _is_run(folder)]


def _is_run(folder: Path) -> bool:
    with contextlib.suppress(FileNotFoundError):  # it may be removed just now
        return folder_mistake(folder) is None and (folder / "log").is_dir()
    return False


def _prune() -> None:
    """Remove the folders of runs long ended, all but the latest few (their logs may still be wanted).

    Fewer stay where they take much: the oldest go until the rest is below a total.
    """
    ended = []
    for folder in _folders():
        with contextlib.suppress(OSError):  # another launch may be removing it just now
            if not is_locked(folder):
                ended.append((folder.stat().st_mtime, folder))
    total_bytes = 0
    for place, (_, folder) in enumerate(sorted(ended, reverse=True)):
        total_bytes += _size(folder)
        if place and (place >= KEEP_ENDED or total_bytes > KEEP_ENDED_BYTES):
            shutil.rmtree(folder, ignore_errors=True)


def _size(folder: Path) -> int:
    found = 0
    for path in folder.rglob("*"):
        with contextlib.suppress(OSError):
            entry = path.lstat()
            found += entry.st_size if stat.S_ISREG(entry.st_mode) else 0
    return found
