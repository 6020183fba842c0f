"""The runtime folder is bounded; where it takes no more a launch is refused in words, and a run goes on."""

from __future__ import annotations

import errno
import logging
import os
import signal
from pathlib import Path
from typing import Any, NoReturn

import psutil
import pytest

from palp_core.errors import GraphError
from palp_core.graph.discovery import run_directory
from palp_core.graph.discovery.run_directory import KEEP_ENDED, RunDirectory, running
from palp_core.graph.transport.restart_files import Offsets
from palp_core.user_folders import runtime_folder
from tests.support.palp import CHAIN, Palp, end, wait_for_error, wait_for_line

FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def full(*_: Any, **__: Any) -> NoReturn:
    raise FULL


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """No file gets room any more."""
    monkeypatch.setattr(os, "posix_fallocate", full)


@pytest.fixture
def own_runtime(monkeypatch: pytest.MonkeyPatch, palp: Palp) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(palp.runtime_dir))
    return runtime_folder()


def test_a_run_in_a_full_folder_is_refused_with_the_folder_and_what_to_do(
    own_runtime: Path, full_disk: None
) -> None:
    with pytest.raises(GraphError) as raised:
        RunDirectory("chain")
    assert str(raised.value).startswith(f"{own_runtime}: No space left on device: a run keeps its sockets")
    assert "make room on that disk, or set XDG_RUNTIME_DIR" in str(raised.value)
    assert not list(own_runtime.iterdir())


@pytest.mark.nightly
def test_a_run_whose_folder_is_full_goes_on_through_a_restart_and_says_so(
    palp: Palp, own_runtime: Path
) -> None:
    process = palp.start("launch", CHAIN, "count:=1000000")
    wait_for_line(process, "blocks: ")
    launcher = psutil.Process(process.pid)
    launcher.rlimit(psutil.RLIMIT_FSIZE, (1000, 1000))  # its record takes more
    (relay,) = [node for node in running()[0].nodes if node.name == "relay"]
    os.kill(relay.pid, signal.SIGKILL)
    said = wait_for_error(process, "The graph continues")
    assert f"{own_runtime}/chain-" in said
    assert "make room on that disk" in said
    palp.printed("topic", "echo", "/relay/amplified", "--once", "--field", "index")
    errors = end(process)
    assert "interrupted by SIGINT; all nodes exited" in errors
    assert palp.all_gone()


def test_a_record_that_cannot_be_written_ends_no_run_that_is_visible_already(
    own_runtime: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    directory = RunDirectory("chain")
    record = directory.record("chain", "chain.yaml", "wall", "ipc:///nowhere", [], [])
    monkeypatch.setattr(run_directory, "write_json", full)
    with pytest.raises(GraphError, match="No space left on device"):
        directory.write(record)
    monkeypatch.undo()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(own_runtime.parent))
    directory.write(record)
    monkeypatch.setattr(run_directory, "write_json", full)
    with caplog.at_level(logging.WARNING, "palp.supervisor"):
        directory.write(record)
    assert "The graph continues" in caplog.text
    directory.remove()


def test_a_node_that_cannot_note_its_place_says_where(tmp_path: Path, full_disk: None) -> None:
    with pytest.raises(GraphError, match=f"{tmp_path}: No space left on device"):
        Offsets(tmp_path / "relay.offsets", ["/source/sample"])


def ended(logged_bytes: int, age_s: int) -> Path:
    """Leave a run that has ended, with a log of so many bytes."""
    directory = RunDirectory("old")
    directory.log("node").write_bytes(bytes(logged_bytes))
    directory.release()
    os.utime(directory.path, (10**9 - age_s,) * 2)
    return directory.path


def test_logs_of_ended_runs_take_so_much_together_and_the_oldest_go(
    own_runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = [ended(400, age_s) for age_s in range(5)]
    monkeypatch.setattr(run_directory, "KEEP_ENDED_BYTES", 1000)
    RunDirectory("new").remove()
    assert [path.exists() for path in runs] == [True, True, False, False, False]


def test_the_latest_run_that_has_ended_keeps_its_logs_whatever_they_take(
    own_runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    latest, before = ended(5000, 0), ended(10, 1)
    monkeypatch.setattr(run_directory, "KEEP_ENDED_BYTES", 1000)
    running_now = RunDirectory("now")
    running_now.log("node").write_bytes(bytes(5000))
    RunDirectory("new").remove()
    assert (latest.exists(), before.exists(), running_now.path.exists()) == (True, False, True)
    running_now.remove()


def test_so_many_small_runs_are_kept(own_runtime: Path) -> None:
    runs = [ended(10, age_s) for age_s in range(KEEP_ENDED + 3)]
    RunDirectory("new").remove()
    assert sum(path.exists() for path in runs) == KEEP_ENDED
    assert runs[0].exists()
