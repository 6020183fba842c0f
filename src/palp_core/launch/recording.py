"""Record a lockstep run into a bag that stands alone: topics, graph, parameters, versions, git state."""

from __future__ import annotations

import json
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import msgspec

from palp_core.bag.recorder import BagRecorder
from palp_core.bag.topic import Topic
from palp_core.bag.writer import BagWriter
from palp_core.errors import BagError
from palp_core.launch.checked import CheckedGraph, resolved_yaml
from palp_core.launch.replay import NODES_ATTACHMENT
from palp_core.runtime.clock import monotonic_ns, unix_ns

__all__ = ["RunRecorder"]

PACKAGES = ("palp", "numpy", "scipy", "pywavelets", "msgspec", "msgpack", "pyzmq")
TICK_FRAMES = 64


class RunRecorder:
    """Observes a lockstep graph and writes its bag.

    Args:
        graph: The graph about to run.
        folder: The bag; must not exist.

    Raises:
        BagError: The folder exists, or the graph runs on the wall clock.
    """

    def __init__(self, graph: CheckedGraph, folder: Path) -> None:
        if graph.clock != "sim":
            raise BagError(f"{graph.file}: only a graph with 'clock: sim' can be recorded by its launcher")
        writer = BagWriter(folder, custom={"start_unix_ns": str(unix_ns())})
        topics = [
            Topic(
                name=name,
                type=topic.type,
                type_hash=topic.type_hash,
                json_schema=topic.json_schema,
                latched_depth=topic.qos.depth if topic.qos.durability == "transient_local" else 0,
            )
            for name, topic in graph.topics.items()
        ]
        self._recorder = BagRecorder(writer, topics, attachments=_attachments(graph))
        self._count = 0

    def __call__(self, now_ns: int, frame: bytes) -> None:
        """Record one frame."""
        self._recorder(now_ns, frame)
        self._count += 1
        if self._count % TICK_FRAMES == 0:
            self._recorder.tick(monotonic_ns())

    def close(self) -> tuple[bool, str]:
        """Close the bag; return whether nothing is missing, and what to say."""
        summary = self._recorder.close()
        return summary.complete, summary.text()


def _attachments(graph: CheckedGraph) -> dict[str, bytes]:
    params = {spec.name: spec.params for spec in graph.nodes}
    return {
        "palp/graph.yaml": resolved_yaml(graph).encode(),
        NODES_ATTACHMENT: msgspec.json.format(msgspec.json.encode(graph.nodes)),
        "palp/parameters.json": json.dumps(params, indent=1).encode(),
        "palp/versions.json": json.dumps(_versions(), indent=1).encode(),
        "palp/git.txt": _git_state(Path(graph.workspace)),
    }


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _git_state(workspace: Path) -> bytes:
    """Return commit and changed files of the workspace; empty where it is no checkout or there is no git."""
    said = b""
    for command in (("rev-parse", "HEAD"), ("status", "--porcelain")):
        try:
            said += subprocess.run(
                ("git", "-C", str(workspace), *command), capture_output=True, check=True, timeout=10.0
            ).stdout
        except (OSError, subprocess.SubprocessError):
            return said
    return said
