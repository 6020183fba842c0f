"""``palp bag replay``: the same bytes from the bag alone, or the first difference by name."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.graph.bag.edit import rewrite
from palp_core.graph.bag.reader import Bag, read
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.topic import Topic
from palp_core.graph.replay.streams import LATE_NS, OrderedMessages, RecordedInputs, key_of
from tests.support.live import ended, recording
from tests.support.palp import CHAIN, PATIENCE_S, SIM, Palp, wait_for_line
from tests.support.rig_session import RigSession
from tests.support.supervised import Running

RIG = "policy,actuator,stage,torque,emg,estimator,phantom,cocontraction"
GOLDEN = Path(__file__).parents[2] / "golden/session.mcap"


def replayed(palp: Palp, bag: Path, nodes: str, launch: Path = CHAIN) -> list[dict[str, Any]]:
    done = palp.printed("bag", "replay", bag, "--nodes", nodes, "--launch", launch, "--compare", "--json")
    found: list[dict[str, Any]] = json.loads(done)
    return found


@pytest.fixture(scope="module")
def whole_bag(shared_palp: Palp, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the chain, recorded from its start to its end."""
    bag = tmp_path_factory.mktemp("whole") / "bag"
    done = shared_palp.printed("launch", CHAIN, "count:=300", "rate_hz:=500.0", "--record", bag)
    assert "nothing missing" in done
    return bag


@pytest.fixture
def relay(tmp_path: Path) -> Path:
    """The file of a node of the same workspace, which may be changed."""
    shutil.copytree(CHAIN.parents[1], tmp_path / "chain")
    return tmp_path / "chain" / "nodes" / "relay.py"


def test_a_recording_from_the_start_replays_every_output(palp: Palp, whole_bag: Path) -> None:
    source, relay, sink = replayed(palp, whole_bag, "source,relay,sink")
    assert (relay["compared"], relay["uncovered"]) == (301, 0)  # samples, and its activation
    assert (source["compared"], source["uncovered"]) == (601, 0)
    assert sink["consumed"] >= 301
    info = json.loads(palp.run("bag", "info", whole_bag, "--json").stdout)
    assert info["complete"]
    assert {"/sink/_events", "/graph/health"} <= set(info["topics"])
    assert [m.value.kind for m in read(whole_bag, ["/graph/events"])] == ["started", "ending"]


def test_recordings_replay_over_changed_parameters_states_and_classes_from_the_start_or_later(
    palp: Palp, tmp_path: Path
) -> None:
    whole, later = tmp_path / "whole", tmp_path / "later"
    graph = palp.start("launch", CHAIN, "count:=1000000", "rate_hz:=100.0", "--record", whole)
    wait_for_line(graph, "blocks: 1/")
    recorder = recording(palp, "-a", "-o", later)
    for words in (
        ("param", "set", "relay", "gain", "3.0"),
        ("lifecycle", "set", "relay", "deactivate"),
        ("lifecycle", "set", "relay", "activate"),
        ("swap", "relay", "nodes.relay:Relay"),
        ("swap", "source", "nodes.source:Source"),
        ("topic", "echo", "/relay/amplified", "--times", "20"),
    ):
        palp.printed(*words)
    graph.send_signal(signal.SIGINT)
    assert "nothing missing" in ended(recorder, None)  # it ends with its graph
    assert [m.value.kind for m in read(later, ["/graph/events"])][-1] == "ending"
    out, errors = graph.communicate(timeout=PATIENCE_S)
    assert "nothing missing" in out, errors
    info = json.loads(palp.run("bag", "info", whole, "--json").stdout)
    assert info["complete"]
    assert all(topic["repeated"] == 0 for topic in info["topics"].values())
    for node in replayed(palp, whole, "source,relay,sink"):
        assert node["divergence"] is None
        assert node["uncovered"] == 0
    for node in replayed(palp, later, "source,relay"):
        assert node["divergence"] is None
        assert node["compared"] > 10
    again = [m.log_ns for m in read(whole, ["/relay/_events"]) if m.value.text == "active -> inactive"]
    rewrite([whole], tmp_path / "reactivated", start_ns=again[0] + 1)
    (node,) = replayed(palp, tmp_path / "reactivated", "relay")
    assert node["divergence"] is None
    assert node["compared"] > 10


def test_a_restarted_node_replays_on_both_sides_of_its_restart(palp: Palp, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    done = palp.here("launch", CHAIN, "count:=300", "rate_hz:=300.0", "fail_at:=100", "--record", bag)
    with Bag(bag) as opened:
        epochs = {m.stream.epoch for m in opened.recorded(["/relay/_order"])}
    assert len(epochs) > 1
    if done.returncode:  # the restarted publisher spoke before the recorder was back, and no longer keeps it
        assert "/relay/amplified: " in done.stdout, done.stdout + done.stderr
        assert " of epoch 1" in done.stdout
        return
    (sink,) = replayed(palp, bag, "sink")
    assert sink["divergence"] is None


def tampered(bag: Path, out: Path, topic: str, sequence: int) -> None:
    """Copy a bag with one number of one message changed."""
    with Bag(bag) as source, BagWriter(out) as writer:
        for name, data in source.attachments().items():
            writer.attach(name, data)
        for m in source.recorded():
            payload = m.payload
            if (m.stream.topic.name, m.sequence) == (topic, sequence):
                value = msgspec.msgpack.decode(payload)
                value["torque_n_m"] = bytes(len(value["torque_n_m"]))
                payload = msgspec.msgpack.encode(value)
            writer.write(writer.stream(m.stream), m.sequence, m.log_ns, m.publish_ns, payload)


def test_a_tampered_recording_gives_the_first_divergence_with_its_inputs(
    palp: Palp, whole_bag: Path, tmp_path: Path
) -> None:
    tampered(whole_bag, tmp_path / "input", "/source/sample", 42)
    tampered(whole_bag, tmp_path / "output", "/relay/amplified", 42)
    for name in ("input", "output"):
        compared = palp.run("bag", "replay", tmp_path / name, "--nodes", "relay", "--launch", CHAIN, "--json")
        assert compared.returncode == 1
        (relay,) = json.loads(compared.stdout)
        first = relay["divergence"]
        assert (first["topic"], first["sequence"]) == ("/relay/amplified", 42)
        assert first["what"].startswith("torque_n_m: recorded")
        assert first["after"].startswith("input:sample 42 at ")
        assert [entry.split(" at ")[0] for entry in first["inputs"]] == [
            f"input:sample {n}" for n in range(38, 43)
        ]
        printed = palp.run("bag", "replay", tmp_path / name, "--nodes", "relay", "--launch", CHAIN)
        assert "differs first on /relay/amplified 42" in printed.stdout


def test_a_recorder_that_is_killed_does_not_end_the_graph_and_its_bag_replays(
    palp: Palp, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    graph = palp.start("launch", CHAIN, "count:=1500", "rate_hz:=500.0", "--record", bag)
    while sum(file.stat().st_size for file in bag.glob("*.mcap")) < 150_000:
        with pytest.raises(subprocess.TimeoutExpired):
            graph.wait(0.02)
    Running(palp).process("recorder").kill()
    out, errors = graph.communicate(timeout=PATIENCE_S)
    assert "chain ended after" in out
    assert graph.returncode == 1
    assert "palp bag recover" in out + errors
    saved = palp.run("bag", "recover", bag, "-o", tmp_path / "saved")
    assert saved.returncode == 1, saved.stderr  # what the recorder had not written
    for node in replayed(palp, tmp_path / "saved", "source,relay,sink"):
        assert node["consumed"] > 100
        assert node["divergence"] is None


@pytest.mark.slow
def test_the_rig_on_the_wall_clock_replays_byte_for_byte(palp: Palp, tmp_path: Path) -> None:
    rig, bag = tmp_path / "rig", tmp_path / "bag"
    for name in ("launch", "nodes", "msgs"):
        shutil.copytree(SIM.parents[1] / name, rig / name)
    launch = rig / "launch" / "sim.yaml"
    text = launch.read_text()
    assert "\nclock: sim\n" in text
    text = re.sub(r"(?m)^checkpoint: .*", "", text)  # its place is one of simulated time
    launch.write_text(text.replace("\nclock: sim\n", "\nclock: wall\n"))
    graph = palp.start(
        "launch", launch, "trials:=1", "training:=1", f"out:={tmp_path / 'out'}", "--record", bag
    )
    wait_for_line(graph, "training: 2/")
    graph.send_signal(signal.SIGINT)
    out, errors = graph.communicate(timeout=PATIENCE_S)
    assert "nothing missing" in out, errors
    for node in replayed(palp, bag, RIG, launch):
        assert node["divergence"] is None
        assert node["compared"] > 0
        assert node["uncovered"] == 0


@pytest.mark.nightly
def test_every_node_of_the_rig_replays_byte_for_byte(palp: Palp, rig_session: RigSession) -> None:
    for node in replayed(palp, rig_session.bag, RIG, SIM):
        assert node["divergence"] is None
        assert node["compared"] > 0
        assert node["consumed"] > 0


def test_a_changed_node_is_caught_at_its_first_different_output(
    palp: Palp, whole_bag: Path, relay: Path
) -> None:
    text, launch = relay.read_text(), relay.parents[1] / "launch" / "chain.yaml"
    assert "self.params.gain," in text
    relay.write_text(text.replace("self.params.gain,", "self.params.gain + (sample.index == 123),"))
    changed = palp.run("bag", "replay", whole_bag, "--nodes", "relay", "--launch", launch, "--json")
    assert changed.returncode == 1
    (node,) = json.loads(changed.stdout)
    assert node["compared"] == 124
    first = node["divergence"]
    assert (first["topic"], first["sequence"]) == ("/relay/amplified", 124)
    assert first["what"].startswith("torque_n_m: recorded")
    assert first["after"].startswith("input:sample 124")
    start = "        self.state.passed_count += 1\n"
    assert start in text
    relay.write_text(text.replace(start, start + "        if sample.index == 299:\n            return\n"))
    fewer = palp.run("bag", "replay", whole_bag, "--nodes", "relay", "--launch", launch)
    assert fewer.returncode == 1
    assert "/relay/amplified 300" in fewer.stdout
    assert "recorded, but not replayed" in fewer.stdout


def test_what_cannot_be_replayed_is_refused_by_name(palp: Palp, whole_bag: Path, tmp_path: Path) -> None:
    rewrite([whole_bag], tmp_path / "bag", select={"/source/sample", "/relay/amplified"}.__contains__)
    for bag, node, launch, words in (
        (whole_bag, "realy", CHAIN, ["no node 'realy' in it; there are: source, relay, sink"]),
        (whole_bag, "sink", SIM, ["No module named 'nodes.sink'", "--launch FILE"]),
        (tmp_path / "bag", "relay", CHAIN, ["/relay/_order", "palp bag record -a"]),
        (GOLDEN, "experiment", SIM, ["node 'experiment' keeps a record on disk"]),
    ):
        refused = palp.run("bag", "replay", bag, "--nodes", node, "--launch", launch)
        assert refused.returncode not in (0, 1)
        assert all(word in refused.stderr for word in words)


TOPIC = Topic(name="/a/b")


def bag_of(folder: Path, messages: list[tuple[int, int, int]]) -> Path:
    """Write messages of (epoch, sequence, log time)."""
    with BagWriter(folder) as writer:
        for epoch, sequence, log_ns in messages:
            writer.write(writer.stream(Stream(topic=TOPIC, epoch=epoch)), sequence, log_ns, log_ns, b"\x80")
    return folder


@settings(max_examples=25)
@given(st.permutations(range(1, 9)), st.permutations(range(1, 5)))
def test_late_messages_stand_where_they_belong(
    tmp_path_factory: object, first: list[int], second: list[int]
) -> None:
    folder = tmp_path_factory.mktemp("bag") / "run"  # type: ignore[attr-defined]
    found = [(0, n) for n in first] + [(1, n) for n in second]
    bag_of(folder, [(epoch, n, place) for place, (epoch, n) in enumerate(found)])
    with Bag(folder) as bag:
        assert [key_of(m) for m in OrderedMessages(bag, "/a/b")] == sorted(found)


def test_a_repeated_message_comes_once_and_a_gap_holds_nothing_up_for_long(tmp_path: Path) -> None:
    late = 2 * LATE_NS
    found = [(0, 1, 0), (0, 2, 1), (0, 2, 2), (0, 4, 3), (0, 5, 4), (0, 6, late), (0, 3, late + 1)]
    bag_of(tmp_path / "run", found)
    with Bag(tmp_path / "run") as bag:
        assert [m.sequence for m in OrderedMessages(bag, "/a/b")] == [1, 2, 4, 5, 6]


def test_an_input_is_found_wherever_it_is_near(tmp_path: Path) -> None:
    bag_of(tmp_path / "run", [(0, n, n) for n in (1, 2, 3, 5, 6)])
    with Bag(tmp_path / "run") as bag:
        inputs = RecordedInputs(bag)
        for sequence in (2, 1, 6, 3):  # replies may come in another order than requests were made
            found = inputs.find("/a/b", 0, sequence)
            assert found is not None
            assert found.sequence == sequence
        assert inputs.find("/a/b", 0, 4) is None
        assert inputs.find("/a/b", 1, 1) is None
