"""``palp bag record`` on a running graph: everything from when it says so, and it says what is missing."""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path
from typing import Any

import psutil
import pytest

from palp_core.graph.bag.metadata import bag_files
from palp_core.graph.bag.reader import Bag, read, to_numpy
from tests.support.live import ended, recording
from tests.support.palp import CHAIN, PATIENCE_S, Palp, wait_for_line
from tests.support.supervised import Running

EVENTS = "/graph/events"


def info(palp: Palp, bag: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(palp.run("bag", "info", bag, "--json").stdout)
    return found


def start_chain(palp: Palp) -> subprocess.Popen[str]:
    """Start a chain on the wall clock that goes on until it is asked to end."""
    process = palp.start("launch", CHAIN, "count:=1000000", "rate_hz:=50.0")
    wait_for_line(process, "blocks: 1/")
    return process


@pytest.fixture(scope="module")
def running(shared_palp: Palp) -> subprocess.Popen[str]:
    """A chain for all tests that only record it."""
    return start_chain(shared_palp)


def test_a_recorder_misses_nothing_from_when_it_says_so_until_it_is_asked_to_end(
    shared_palp: Palp, running: subprocess.Popen[str], tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    recorder = recording(shared_palp, "-a", "-o", bag, "--max-bag-duration", "0.1")
    shared_palp.printed("param", "set", "relay", "gain", "3.0")
    assert "nothing missing" in ended(recorder)
    found = info(shared_palp, bag)
    assert found["complete"]
    assert found["healthy"]
    indices = to_numpy(bag, "/relay/amplified", "index")
    assert indices.tolist() == list(range(int(indices[0]), int(indices[0]) + len(indices)))
    kept = {
        "palp/graph.yaml",
        "palp/nodes.json",
        "palp/parameters.json",
        "palp/versions.json",
        "palp/git.txt",
    }
    assert kept < set(found["attachments"])
    assert "gain = 3.0" in next(m.value.text for m in read(bag, ["/relay/_events"]))
    assert len([m for m in read(bag, [EVENTS]) if m.value.kind == "started"]) == 1
    files = bag_files(bag)
    assert len(files) > 1
    for file in files:  # each begins with the latched messages
        assert next(m.value.kind for m in read(file, [EVENTS])) == "started"
    assert {"/graph/health", "/source/_order", "/source/progress"} <= set(found["topics"])
    with Bag(bag) as opened:
        attached = opened.metadata()["palp"]
        assert (attached["clock"], attached["graph"], attached["run"]) == (
            "wall",
            "chain",
            Running(shared_palp).folder.name,
        )
    assert running.poll() is None


def test_topics_are_chosen_by_name_and_regular_expression(
    shared_palp: Palp, running: subprocess.Popen[str], tmp_path: Path
) -> None:
    recorder = recording(
        shared_palp,
        "/source/sample",
        "-e",
        "^/relay/",
        "-x",
        "_order",
        "-o",
        tmp_path / "a",
        "--compression",
        "lz4",
    )
    source = Running(shared_palp).record["nodes"][0]
    assert source["name"] == "source"
    ended(recorder, signal.SIGTERM)
    with Bag(tmp_path / "a") as opened:
        assert set(opened.topics()) <= {"/source/sample", "/relay/amplified", "/relay/_events"}
    assert len(to_numpy(tmp_path / "a", "/source/sample", "index")) > 0
    wrong = shared_palp.refused("bag", "record", "/source/sampel", "-o", tmp_path / "b")
    assert "did you mean '/source/sample'" in wrong
    assert not (tmp_path / "b").exists()
    for arguments in ((), ("-a", "/source/sample"), ("-e", "nothing", "-o", tmp_path / "b")):
        assert shared_palp.here("bag", "record", *arguments).returncode == 2
    assert not (tmp_path / "b").exists()
    assert "exists already" in shared_palp.refused("bag", "record", "-a", "-o", tmp_path / "a")
    for words, text in (((), "no recorder keeps"), (("--graph", "chian"), "did you mean 'chain'")):
        assert text in shared_palp.refused("bag", "snapshot", *words)


def test_a_full_disk_ends_the_recorder_and_nothing_else(
    shared_palp: Palp, running: subprocess.Popen[str], tmp_path: Path
) -> None:
    recorder = recording(shared_palp, "-a", "-o", tmp_path / "bag", "--compression", "none")
    psutil.Process(recorder.pid).rlimit(psutil.RLIMIT_FSIZE, (100_000, 100_000))
    _, errors = recorder.communicate(timeout=PATIENCE_S)
    assert recorder.returncode == 2
    assert "cannot be written" in errors
    assert "palp bag recover" in errors
    assert running.poll() is None
    saved = shared_palp.run("bag", "recover", tmp_path / "bag", "-o", tmp_path / "saved")
    assert saved.returncode == 1, saved.stderr  # what did not fit
