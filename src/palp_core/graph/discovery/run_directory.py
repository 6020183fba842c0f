"""The folder of a run: sockets, logs, and ``graph.json``, by which the command line finds a running graph."""

import contextlib
import fcntl
import os
import re
import shutil
import tempfile
from pathlib import Path

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.clock import unix_ns
from palp_core.graph.messages.topic import Topic
from palp_core.graph.problems import hint
from palp_core.user_folders import folder_mistake, own_folder, runtime_folder
from palp_core.whole_file import PRIVATE, open_private, write_json

KEEP_ENDED = 10
RECORD = "graph.json"


class NodeEntry(msgspec.Struct, frozen=True):
    """A node of a running graph."""

    name: str
    run: str
    pid: int
    publish: str
    serve: str


class RunRecord(msgspec.Struct, frozen=True):
    """What ``graph.json`` holds: ``serve`` is where the launcher answers, ``listen`` where others call."""

    graph: str
    file: str
    clock: str
    pid: int
    start_unix_ns: int
    serve: str
    nodes: list[NodeEntry]
    topics: list[Topic]
    listen: str = ""


class _NotOwn(GraphError):
    """The folder of all runs may be another's work."""

    def __init__(self, mistake: str) -> None:
        super().__init__(f"{mistake}; set XDG_RUNTIME_DIR to a folder of your own")


class RunDirectory:
    """A folder only its owner can enter; created anew for each run, and locked while the run lasts.

    Raises:
        GraphError: The folder belongs to somebody else or cannot be written to.
    """

    def __init__(self, graph: str) -> None:
        base = runtime_folder()
        try:
            if (mistake := own_folder(base)) is not None:
                raise _NotOwn(mistake)
            _prune()
            prefix = re.sub(r"[^A-Za-z0-9_]", "_", graph[:16])
            self.path = Path(tempfile.mkdtemp(prefix=f"{prefix}-", dir=base))
            self._lock = os.open(self.path, os.O_RDONLY)
            fcntl.flock(self._lock, fcntl.LOCK_EX)
            (self.path / "log").mkdir(mode=0o700)
        except OSError as error:
            raise GraphError(
                f"no run directory in {base}: {error.strerror}; set XDG_RUNTIME_DIR to a folder of your own"
            ) from error

    def log(self, node: str) -> Path:
        """Return the log file of a node."""
        return self.path / "log" / f"{node}.log"

    def write(self, record: RunRecord) -> None:
        """Make the graph visible to the command line."""
        write_json(self.path / RECORD, record, mode=PRIVATE)

    def remove(self) -> None:
        """Remove the folder with its logs."""
        shutil.rmtree(self.path, ignore_errors=True)
        self.release()

    def release(self) -> None:
        """Leave the folder with its logs to later runs, which remove it when it is one of many."""
        if self._lock >= 0:
            os.close(self._lock)
        self._lock = -1


def record_for(
    graph: str, file: str, clock: str, serve: str, nodes: list[NodeEntry], topics: list[Topic]
) -> RunRecord:
    """Return the record of a graph that this process supervises."""
    return RunRecord(graph, file, clock, os.getpid(), unix_ns(), serve, nodes, topics)


def _read(folder: Path) -> RunRecord | None:
    try:
        with open(folder / RECORD, "rb", opener=open_private) as file:
            return msgspec.json.decode(file.read(), type=RunRecord)
    except (OSError, msgspec.MsgspecError):
        return None


def runs() -> list[tuple[Path, RunRecord, bool]]:
    """Return every run of this user with a record: folder, record, whether it lives; the latest first."""
    found = [(folder, record, locked(folder)) for folder in _folders() if (record := _read(folder))]
    return sorted(found, key=lambda run: -run[1].start_unix_ns)


def running() -> list[RunRecord]:
    """Return the running graphs of this user, the latest first."""
    return [record for _, record, lives in runs() if lives]


def find_running(name: str | None = None) -> RunRecord:
    """Return the running graph, the latest if there are several.

    Raises:
        GraphError: None runs, or none of that name.
    """
    known = running()
    found = [record for record in known if name is None or record.graph == name]
    if found:
        return found[0]
    if name is not None and known:
        raise GraphError(f"no graph named '{name}' is running{hint(name, (r.graph for r in known))}")
    what = f"no graph named '{name}' is running" if name else "no graph is running"
    raise GraphError(f"{what}; start one with: palp launch FILE")


def _folders() -> list[Path]:
    """Return the folders of runs.

    Raises:
        GraphError: Another may have put there what is in them.
    """
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
    """Remove the folders of runs long ended, all but the latest few (their logs may still be wanted)."""
    ended = []
    for folder in _folders():
        with contextlib.suppress(OSError):  # another launch may be removing it just now
            if not locked(folder):
                ended.append((folder.stat().st_mtime, folder))
    for _, folder in sorted(ended, reverse=True)[KEEP_ENDED:]:
        shutil.rmtree(folder, ignore_errors=True)


def locked(folder: Path) -> bool:
    """Tell whether a run holds its folder: the lock goes with the process that has it, however that ends."""
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)  # shared: two who ask do not see each other
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False
