"""``palp launch --record``: from sample 0 on, on the wall clock in a process of its own."""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest
from mcap.exceptions import EndOfFile
from mcap.records import Message
from mcap.stream_reader import StreamReader

from palp_core.graph.bag.reader import read, to_numpy
from palp_core.graph.clock import monotonic_ns
from tests.support.live import ended, recording
from tests.support.palp import CHAIN, PATIENCE_S, Palp, own_workspace, wait_for_line
from tests.support.rig_session import ComposedGraph
from tests.support.supervised import Running

MOST_LOST_S = 0.6
"""Where nothing else runs; on a given clock the same is held of the writer of bags."""


def recorder_of(palp: Palp, name: str = "recorder") -> psutil.Process:
    """The recorder's process."""
    return Running(palp).process(name)


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """A copy of the chain whose launch file has a recorder as one of its entries."""
    folder = tmp_path / "chain"
    shutil.copytree(CHAIN.parents[1], folder)
    launch = folder / "launch" / "chain.yaml"
    text = launch.read_text().replace(
        "nodes:\n",
        "  required: {default: false, help: the recorder}\n  bag: {default: bag, help: its bag}\n"
        "  keep_s: {default: 0.0, help: seconds in memory}\nnodes:\n",
    )
    entry = (
        "  tape:\n    run: palp_core.graph.recording.recorder_node:Recorder\n"
        "    params: {out: $(var bag), exclude_regex: /progress$, required: $(var required), "
        "snapshot_s: $(var keep_s), snapshot_on_trouble: true}\n"
    )
    launch.write_text(text + entry)
    return launch


def whole_message_count(bag: Path) -> int:
    """Count the messages that another reader finds before the file is torn."""
    count = 0
    for file in bag.glob("*.mcap"):
        with file.open("rb") as stream, contextlib.suppress(EndOfFile, struct.error):
            for record in StreamReader(stream).records:
                count += isinstance(record, Message)
    return count


def recovered_from_kills(palp: Palp, folder: Path, kills: int) -> Iterator[float]:
    """Kill recorders of a running graph; give what each had not written yet, in s, when the rest is whole."""
    graph = palp.start("launch", CHAIN, "count:=1000000", "rate_hz:=500.0")
    wait_for_line(graph, "blocks: 1/")
    clock = Running(palp).ask("graph", "clock")
    start_ns = clock["monotonic_ns"] - clock["now_ns"]
    rng = np.random.default_rng(kills)
    for number in range(kills):
        bag, saved = folder / f"bag{number}", folder / f"saved{number}"
        recorder = recording(palp, "-a", "-o", bag)
        written, enough = 0, rng.integers(20_000, 200_000)
        while written < enough:  # bytes in the file: a chunk or some
            assert not psutil.wait_procs([psutil.Process(recorder.pid)], timeout=0.01)[0]
            written = sum(file.stat().st_size for file in bag.glob("*.mcap"))
        recorder.kill()
        killed_s = (monotonic_ns() - start_ns) / 1e9
        recorder.wait()
        done = palp.run("bag", "recover", bag, "-o", saved)
        assert done.returncode == 1, done.stderr  # what was not written yet
        messages = list(read(saved))
        indices = [m.value.index for m in messages if m.topic == "/source/sample"]
        first = indices[0] if indices else 0  # none if it was killed within the write of the second chunk
        assert indices == list(range(first, first + len(indices)))
        info = json.loads(palp.run("bag", "info", saved, "--json").stdout)
        assert sum(topic["lost"] for topic in info["topics"].values()) == 0
        assert info["message_count"] == len(messages) >= whole_message_count(bag) > 0
        assert not info["accounted"]  # and it says that what came after the last message does not show
        yield killed_s - max(m.log_ns for m in messages) / 1e9


@pytest.mark.slow
def test_a_killed_recorder_costs_little(palp: Palp, tmp_path: Path) -> None:
    assert max(recovered_from_kills(palp, tmp_path, 50)) <= MOST_LOST_S


def test_a_launch_file_may_have_a_recorder_among_its_nodes(
    palp: Palp, workspace: Path, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    done = palp.printed("launch", workspace, "count:=50", f"bag:={bag}")
    assert f"{bag}: " in done
    assert to_numpy(bag, "/source/sample", "index").tolist() == list(range(50))
    info = json.loads(palp.run("bag", "info", bag, "--json").stdout)
    assert info["complete"]
    assert "/source/progress" not in info["topics"]
    assert "exists already" in palp.refused("launch", workspace, "count:=50", f"bag:={bag}")
    printed = palp.here("graph", "show", workspace)
    assert "palp_core.graph.recording.recorder_node:Recorder" in printed.stdout


def test_a_graph_that_requires_its_recorder_ends_with_it(palp: Palp, workspace: Path, tmp_path: Path) -> None:
    graph = palp.start("launch", workspace, "count:=1000000", "required:=true", f"bag:={tmp_path / 'bag'}")
    wait_for_line(graph, "blocks: 1/")
    recorder_of(palp, "tape").kill()
    _, errors = graph.communicate(timeout=PATIENCE_S)
    assert graph.returncode == 1
    assert "tape: its process" in errors
    assert palp.all_gone()


def test_a_killed_launcher_leaves_a_finished_bag(palp: Palp, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    graph = palp.start("launch", CHAIN, "count:=1000000", "--record", bag)
    wait_for_line(graph, "blocks: 1/")
    graph.kill()
    graph.wait()
    assert palp.all_gone()
    info = json.loads(palp.run("bag", "info", bag, "--json").stdout)
    assert info["healthy"]
    assert info["accounted"]


def test_recorders_write_the_last_seconds_on_request_and_after_a_crash(
    palp: Palp, workspace: Path, tmp_path: Path
) -> None:
    bag, other = tmp_path / "last", tmp_path / "other"
    graph = palp.start("launch", workspace, "count:=1000000", "keep_s:=5.0", f"bag:={bag}")
    wait_for_line(graph, "blocks: 1/")
    recorder = recording(palp, "-a", "-o", other, "--snapshot", "0.3")
    assert palp.run("topic", "echo", "/source/sample", "--times", "25").returncode == 0  # half a second
    asked = palp.printed("bag", "snapshot")
    assert asked.count("nothing missing") == 2
    assert palp.here("service", "call", "/tape/save").returncode == 0
    for folder in (bag, bag.with_name("last-1"), other):
        assert len(to_numpy(folder, "/source/sample", "index")) > 0
    times_ns = [m.log_ns for m in read(other, ["/source/sample"])]
    assert times_ns[-1] - times_ns[0] <= 300_000_000
    assert next(m.value.kind for m in read(other, ["/graph/events"])) == "started"  # latched
    Running(palp).process("relay").kill()
    Running(palp).until((bag.with_name("last-2") / "metadata.yaml").exists)
    kinds = [m.value.kind for m in read(bag.with_name("last-2"), ["/graph/events"])]
    assert kinds == ["started", "restarting", "restarted"]
    assert palp.here("graph", "end").returncode == 0
    ended(recorder, None)
    out, errors = graph.communicate(timeout=PATIENCE_S)
    assert graph.returncode == 130
    assert re.search(r"/relay: .*; the last 5 s are in .*last-2: [0-9]+ messages", errors)
    assert re.findall(r"(?m)^/.*/(last[-0-9]*): [0-9]+ messages on [0-9]+ topics, nothing missing", out) == [
        "last",
        "last-1",
        "last-2",
    ]


@pytest.mark.nightly
def test_a_recorder_that_hangs_keeps_no_other_from_finishing_its_bag(
    palp: Palp, workspace: Path, tmp_path: Path
) -> None:
    palp.constants["palp_core.graph.supervision.supervisor:FINISH_NS"] = 100_000_000
    bags = tmp_path / "tape", tmp_path / "other"
    graph = palp.start("launch", workspace, "count:=1000000", f"bag:={bags[0]}", "--record", bags[1])
    wait_for_line(graph, "blocks: 1/")
    recorder_of(palp, "tape").suspend()
    assert palp.here("graph", "end").returncode == 0
    out, _ = graph.communicate(timeout=PATIENCE_S)
    assert out.count(", nothing missing\n") == 2  # the other at once, the first when it was continued
    assert palp.all_gone()


def test_in_lockstep_a_recording_holds_every_message_from_the_first(palp: Palp, tmp_path: Path) -> None:
    done = palp.printed("launch", CHAIN, "clock:=sim", "count:=50", "--record", tmp_path / "processes")
    assert "nothing missing" in done
    chain: dict[str, object] = {"clock": "sim", "count": 50}
    with own_workspace(), ComposedGraph(CHAIN, record=tmp_path / "composed", **chain) as graph:
        graph.run()
    assert graph.recorders.complete
    palp.printed("bag", "diff", tmp_path / "composed", tmp_path / "processes")
    indices = to_numpy(tmp_path / "composed", "/relay/amplified", "index")
    assert indices.tolist() == list(range(50))
    raw = np.stack([m.value.torque_n_m for m in read(tmp_path / "composed", ["/source/sample"])])
    amplified = np.stack([m.value.torque_n_m for m in read(tmp_path / "composed", ["/relay/amplified"])])
    assert np.array_equal(2.0 * raw, amplified)
    info = json.loads(palp.run("bag", "info", tmp_path / "composed", "--json").stdout)
    assert {"/source/sample", "/relay/amplified", "/relay/_order"} <= set(info["topics"])
