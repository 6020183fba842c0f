"""The folder of a run: sockets, logs, and ``graph.json``, by which the command line finds a running graph."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import msgspec
import psutil

from palp_core.errors import GraphError
from palp_core.runtime.clock import unix_ns

__all__ = ["NodeEntry", "RunDirectory", "RunRecord", "TopicEntry", "find_running", "running"]

KEEP_ENDED = 10
LONGEST_BASE = 36  # a socket's path holds 107 bytes: this, a run's name, a node's name


class NodeEntry(msgspec.Struct, frozen=True):
    """A node of a running graph."""

    name: str
    run: str
    pid: int
    publish: str
    serve: str


class TopicEntry(msgspec.Struct, frozen=True):
    """A topic of a running graph."""

    name: str
    type: str
    type_hash: str
    node: str
    publish: str
    json_schema: dict[str, Any]


class RunRecord(msgspec.Struct, frozen=True):
    """What ``graph.json`` holds."""

    graph: str
    file: str
    clock: str
    pid: int
    pid_start_s: float
    start_unix_ns: int
    nodes: list[NodeEntry]
    topics: list[TopicEntry]

    def alive(self) -> bool:
        """Tell whether the supervisor that wrote this still runs."""
        try:
            return abs(psutil.Process(self.pid).create_time() - self.pid_start_s) < 1.0
        except psutil.NoSuchProcess:
            return False


def _base() -> Path:
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and len(runtime) <= LONGEST_BASE and os.access(runtime, os.W_OK):
        return Path(runtime) / "palp"
    return Path(tempfile.gettempdir()) / f"palp-{os.getuid()}"


class RunDirectory:
    """A folder only its owner can enter; created anew for each run.

    Raises:
        GraphError: The folder belongs to somebody else.
    """

    def __init__(self, graph: str) -> None:
        base = _base()
        base.mkdir(mode=0o700, parents=True, exist_ok=True)
        if base.stat().st_uid != os.getuid():
            raise GraphError(f"{base} belongs to another user; set XDG_RUNTIME_DIR to a folder of your own")
        base.chmod(0o700)
        _prune(base)
        self.path = Path(tempfile.mkdtemp(prefix=f"{graph[:16]}-", dir=base))
        (self.path / "log").mkdir()

    def log(self, node: str) -> Path:
        """Return the log file of a node."""
        return self.path / "log" / f"{node}.log"

    def write(self, record: RunRecord) -> None:
        """Make the graph visible to the command line."""
        temporary = self.path / "graph.json.part"
        temporary.write_bytes(msgspec.json.format(msgspec.json.encode(record)))
        temporary.rename(self.path / "graph.json")

    def remove(self) -> None:
        """Remove the folder with its logs."""
        shutil.rmtree(self.path, ignore_errors=True)


def record_for(
    graph: str, file: str, clock: str, nodes: list[NodeEntry], topics: list[TopicEntry]
) -> RunRecord:
    """Return the record of a graph that this process supervises."""
    started_s = psutil.Process().create_time()
    return RunRecord(graph, file, clock, os.getpid(), started_s, unix_ns(), nodes, topics)


def _read(folder: Path) -> RunRecord | None:
    with contextlib.suppress(OSError, msgspec.MsgspecError):
        return msgspec.json.decode((folder / "graph.json").read_bytes(), type=RunRecord)
    return None


def running() -> list[RunRecord]:
    """Return the running graphs of this user, the latest first."""
    base = _base()
    if not base.is_dir():
        return []
    records = [
        record for folder in base.iterdir() if (record := _read(folder)) is not None and record.alive()
    ]
    return sorted(records, key=lambda record: -record.start_unix_ns)


def find_running(name: str | None = None) -> RunRecord:
    """Return the running graph, the latest if there are several.

    Raises:
        GraphError: None runs, or none of that name.
    """
    found = [record for record in running() if name is None or record.graph == name]
    if not found:
        what = f"no graph named '{name}' is running" if name else "no graph is running"
        raise GraphError(f"{what}; start one with: palp launch FILE")
    return found[0]


def _prune(base: Path) -> None:
    """Remove the folders of runs long ended, all but the latest few (their logs may still be wanted)."""
    ended = [f for f in base.iterdir() if f.is_dir() and not ((r := _read(f)) is not None and r.alive())]
    ended.sort(key=lambda folder: folder.stat().st_mtime, reverse=True)
    for folder in ended[KEEP_ENDED:]:
        shutil.rmtree(folder, ignore_errors=True)
