"""A bag that cannot be written any more: what is written stays whole, and the graph goes on."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from palp_core.errors import BagError, NodeError
from palp_core.graph.bag.mcap.file_writer import FileWriter
from palp_core.graph.bag.reader import read
from palp_core.graph.bag.recover import recover
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.launch.graph import Graph
from palp_core.graph.supervision.launcher_node import LauncherNode
from tests.support.palp import CHAIN, Palp

GOLDEN = Path(__file__).parents[2] / "golden/session.mcap"
ROOM = 30_000
"""Of the disk: enough for what a bag of the chain begins with, and some chunks."""


class FullDisk:
    """A file that takes part of what it is given where the disk is full, and nothing from then on."""

    def __init__(self, file: Any, room: int) -> None:
        self._file, self._room = file, room

    def write(self, data: memoryview) -> int:
        if not self._room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        count: int = self._file.write(data[: self._room])
        self._room -= count
        return count

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


@pytest.fixture
def small_disk(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Let bags be on a disk with little room, in small chunks; return what the launcher says in events."""
    begin: Callable[..., None] = FileWriter.__init__

    def limited(self: FileWriter, *arguments: Any) -> None:
        begin(self, *arguments)
        limited_file: Any = FullDisk(self._file, ROOM - self.written_bytes)
        self._file = limited_file

    events: list[str] = []
    report: Callable[..., None] = LauncherNode.report

    def noted(self: LauncherNode, kind: str, node: str, text: str, /, **data: Any) -> None:
        events.append(f"{kind} {node} {text}")
        report(self, kind, node, text, **data)

    monkeypatch.setattr(FileWriter, "__init__", limited)
    monkeypatch.setitem(BagWriter.__init__.__kwdefaults__ or {}, "chunk_bytes", 2000)
    monkeypatch.setattr(LauncherNode, "report", noted)
    return events


def test_in_lockstep_it_is_reported_and_the_graph_goes_on(small_disk: list[str], tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    with Graph(CHAIN, record=bag, clock="sim", count=100) as graph:
        summary = graph.run()
    assert summary.exit_code == 0
    assert not graph.recorders.complete
    assert f"{bag}: cannot be written any more: No space left on device" in graph.recorders.text
    assert f"palp bag recover {bag} -o NEW" in graph.recorders.text
    assert [line for line in small_disk if line.startswith("recorder recorder ")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FullDisk, "write", lambda self, data: self._file.write(data))
        report = recover(bag, tmp_path / "new")
    assert (report.damaged_chunk_count, report.damaged_bytes, report.unverified_count) == (0, 0, 0)
    sequences = [message.sequence for message in read(tmp_path / "new", ["/source/sample"])]
    assert sequences == list(range(1, len(sequences) + 1))
    assert 0 < len(sequences) < 100


def test_a_recorder_that_the_graph_needs_ends_it_in_order(small_disk: list[str], tmp_path: Path) -> None:
    text = CHAIN.read_text().replace(
        "nodes:\n",
        "nodes:\n  tape:\n    run: palp_core.graph.recording.recorder_node:Recorder\n"
        f"    params: {{out: {tmp_path / 'bag'}, required: true}}\n",
        1,
    )
    (tmp_path / "nodes").symlink_to(CHAIN.parents[1] / "nodes")
    (tmp_path / "msgs").symlink_to(CHAIN.parents[1] / "msgs")
    (tmp_path / "chain.yaml").write_text(text)
    graph = Graph(tmp_path / "chain.yaml", clock="sim", count=100)
    with pytest.raises(NodeError, match=r"tape: .*No space left on device"), graph:
        graph.run()
    assert small_disk


def test_a_bag_that_cannot_be_begun_is_refused_before_anything_starts(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def refuse(self: FileWriter, data: bytes) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(self.path))

    monkeypatch.setattr(FileWriter, "_write_bytes", refuse)
    with (
        pytest.raises(BagError, match="Read-only file system"),
        Graph(CHAIN, record=tmp_path / "bag", clock="sim"),
    ):
        pass
    assert not (tmp_path / "bag").exists()


def test_a_bag_that_a_full_disk_cuts_is_not_recovered_in_part(small_disk: list[str], tmp_path: Path) -> None:
    assert not small_disk
    with pytest.raises(OSError, match="No space left on device"):
        recover(GOLDEN, tmp_path / "saved")
    assert not (tmp_path / "saved").exists()


def test_a_conversion_that_a_limit_cuts_is_reported_without_a_traceback(palp: Palp, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = subprocess.run(
        palp.command("bag", "convert", GOLDEN, "--to", "csv", "-o", out),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)),
        capture_output=True,
        text=True,
        check=False,
        env=palp.environment,
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr == f"{out} cannot be written: File too large\n"
    assert not out.exists()
