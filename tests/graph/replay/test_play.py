"""``palp bag play`` and players in launch files: recorded nodes speak again, to tools and to live nodes."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import select
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from palp_core.errors import PalpError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.discovery.run_directory import RunRecord
from palp_core.graph.messages.frame import Frame, Kind, parse
from palp_core.graph.transport.subscriber_socket import SubscriberSocket
from tests.support.palp import CHAIN, PATIENCE_S, Palp, wait_for_error, wait_for_line
from tests.support.rig_session import check_here

COUNT = 60
REPLAYED = """
graph: again
clock: sim
args: {bag: {default: bag}}
nodes:
  source:
    run: palp_core.graph.replay.player:Player
    params: {bag: $(var bag)}
    on_exit: shutdown
  relay: {run: nodes.relay:Relay, inputs: {sample: source/sample}}
  sink:
    run: nodes.sink:Sink
    params: {count: 60}
    inputs: {sample: relay/amplified}
"""
OPEN_RELAY = """
graph: open
clock: wall
args: {out: {default: ""}}
nodes:
  relay: {run: nodes.relay:Relay, inputs: {sample: {external: true}}}
  sink:
    run: nodes.sink:Sink
    params: {count: 60, out: $(var out)}
    inputs: {sample: relay/amplified}
    on_exit: shutdown
"""


@pytest.fixture(scope="module")
def recorded(shared_palp: Palp, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A copy of the chain with more launch files, and the bag of a run of it."""
    folder = tmp_path_factory.mktemp("play")
    workspace = folder / "chain"
    shutil.copytree(CHAIN.parents[1], workspace)
    for name, text in (("again", REPLAYED), ("open", OPEN_RELAY)):
        (workspace / "launch" / f"{name}.yaml").write_text(text)
    launch = workspace / "launch" / "chain.yaml"
    shared_palp.printed(
        "launch", launch, "clock:=sim", f"count:={COUNT}", "--compose", "--record", folder / "bag"
    )
    return folder / "bag", workspace / "launch"


def payloads(bag: Path, topic: str) -> list[bytes]:
    with Bag(bag) as opened:
        return [message.payload for message in opened.recorded([topic])]


def begun(process: subprocess.Popen[str], palp: Palp) -> RunRecord:
    """Wait until the player says that it plays; return where."""
    wait_for_error(process, "as graph 'play'")
    (file,) = palp.runtime_dir.glob("palp/play-*/graph.json")
    return msgspec.json.decode(file.read_bytes(), type=RunRecord)


@contextlib.contextmanager
def hearing(record: RunRecord, *topics: str) -> Iterator[Callable[[int], list[Frame]]]:
    """Subscribe to topics; the function waits for so many messages."""
    at = {entry.name: entry.publish for entry in record.topics}
    subscriber = SubscriberSocket({topic: at[topic] for topic in topics})

    def received(count: int) -> list[Frame]:
        found: list[Frame] = []
        while len(found) < count:
            assert subscriber.wait(PATIENCE_S), f"{len(found)} messages"
            found += [frame for frame in map(parse, subscriber.receive()) if frame.kind == Kind.DATA]
        return found

    try:
        yield received
    finally:
        subscriber.close()


def test_what_is_played_comes_as_recorded_from_the_recorded_nodes(
    palp: Palp, recorded: tuple[Path, Path]
) -> None:
    bag, _ = recorded
    renamed = ("--remap", "/source/progress:=/a/b")
    process = palp.start("bag", "play", bag, "-w", "3", "-r", "2", "--json", *renamed)
    record = begun(process, palp)
    assert [node.name for node in record.nodes] == ["relay", "a", "source"]
    with hearing(record, "/source/sample", "/relay/amplified", "/a/b") as received:
        frames = received(3 * COUNT)
    assert [bytes(f.payload) for f in frames if f.topic == "/a/b"] == payloads(bag, "/source/progress")
    frames = [frame for frame in frames if frame.topic != "/a/b"]
    assert process.wait(PATIENCE_S) == 0
    with Bag(bag) as opened:
        in_order = [
            (m.stream.topic.name, m.payload) for m in opened.recorded(["/source/sample", "/relay/amplified"])
        ]
        hashes = {name: topic.type_hash for name, topic in opened.topics().items()}
    assert [(frame.topic, bytes(frame.payload)) for frame in frames] == in_order
    assert {(frame.topic, f"{frame.type_hash:016x}") for frame in frames} == {
        (name, hashes[name]) for name in ("/source/sample", "/relay/amplified")
    }
    stamps = [frame.stamp_ns for frame in frames]
    assert stamps == sorted(stamps)
    assert process.stdout is not None
    account = json.loads(process.stdout.read())
    assert account["messages"] == len(in_order) + COUNT


def test_tools_see_the_recorded_nodes(palp: Palp, recorded: tuple[Path, Path]) -> None:
    bag, _ = recorded
    process = palp.start("bag", "play", bag, "-w", "1", "-t", "/source/sample", "-r", "3")
    begun(process, palp)
    assert "/source/sample [Sample]" in palp.run("topic", "list", "-t").stdout
    assert "/source" in palp.run("node", "list").stdout
    assert "/relay/amplified" not in palp.run("topic", "list").stdout
    assert palp.here("bag", "play", bag, "-t", "/no/where").returncode == 2
    echo = palp.printed(
        "topic", "echo", "/source/sample", "--times", "3", "--json", "--qos-reliability", "reliable"
    )
    indices = [json.loads(line)["index"] for line in echo.splitlines()]
    assert indices == [0, 1, 2]
    assert process.wait(PATIENCE_S) == 0
    assert not list(palp.runtime_dir.glob("palp/play-*"))


def test_keys_pause_and_change_the_speed(palp: Palp, recorded: tuple[Path, Path]) -> None:
    bag, _ = recorded
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        palp.command("bag", "play", bag, "-w", "1", "-p", "-r", "5", "-t", "/source/sample"),
        env=palp.environment,
        stdin=theirs,
        stderr=theirs,
        stdout=subprocess.PIPE,
        text=True,
    )
    os.close(theirs)
    screen = ""

    def until(text: str) -> None:
        nonlocal screen
        while text not in screen:
            assert select.select([ours], [], [], PATIENCE_S)[0], screen
            screen += os.read(ours, 4096).decode(errors="replace")  # a letter may come in two parts
        screen = screen[screen.index(text) + len(text) :]

    try:
        until("waiting")
        (file,) = palp.runtime_dir.glob("palp/play-*/graph.json")
        record = msgspec.json.decode(file.read_bytes(), type=RunRecord)
        recorded_payloads = payloads(bag, "/source/sample")
        with hearing(record, "/source/sample") as received:
            until("paused")
            os.write(ours, b"\x1b[A")
            until("5.5 times real time, paused")
            os.write(ours, b"\x1b[B")
            until("5 times real time, paused")
            os.write(ours, b" ")
            assert [bytes(frame.payload) for frame in received(COUNT)] == recorded_payloads
        until("playing")
        assert process.wait(PATIENCE_S) == 0
        assert process.stdout is not None
        assert f"played {COUNT} messages of 1 topic; never more than" in process.stdout.read()
    finally:
        process.kill()
        process.wait()
        os.close(ours)
        if process.stdout is not None:
            process.stdout.close()


def test_a_loop_goes_on_until_it_is_asked_to_end_and_says_what_it_has_played(
    palp: Palp, recorded: tuple[Path, Path]
) -> None:
    bag, _ = recorded
    process = palp.start("bag", "play", bag, "-l", "-w", "1", "-r", "5", "-t", "/source/sample", "--json")
    record = begun(process, palp)
    with hearing(record, "/source/sample") as received:
        frames = received(2 * COUNT + 5)
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE_S) == 130
    assert process.stdout is not None
    account = json.loads(process.stdout.read())
    assert account["interrupted"] is True
    assert account["messages"] >= 2 * COUNT + 5
    once = payloads(bag, "/source/sample")
    assert [bytes(frame.payload) for frame in frames[: 2 * COUNT]] == once * 2
    assert [frame.sequence for frame in frames] == list(range(1, len(frames) + 1))
    assert not list(palp.runtime_dir.glob("palp/play-*"))


def test_a_bag_plays_into_a_running_graph_in_place_of_a_node(
    palp: Palp, recorded: tuple[Path, Path], tmp_path: Path
) -> None:
    bag, launch = recorded
    graph = palp.start("launch", launch / "open.yaml", f"out:={tmp_path / 'out.json'}")
    while "active" not in palp.run("lifecycle", "get", "/relay").stdout:
        with pytest.raises(subprocess.TimeoutExpired):
            graph.wait(0.05)
    play = ("bag", "play", bag, "--graph", "open")
    assert "takes none of the bag's topics from outside; it takes: /relay/sample" in palp.refused(*play)
    wrong = palp.refused(*play, "-m", "/source/progress:=/relay/sample")
    assert "/relay/sample takes another type than Progress" in wrong
    played = palp.run(*play, "-m", "/source/sample:=/relay/sample", "-r", "5")
    assert played.returncode == 0, played.stderr
    assert "no port of graph 'open' takes /relay/amplified, /source/progress" in played.stderr
    assert graph.wait(PATIENCE_S) == 0
    assert json.loads((tmp_path / "out.json").read_text()) == list(range(COUNT))


def test_a_recording_takes_the_place_of_a_live_node(palp: Palp, recorded: tuple[Path, Path]) -> None:
    bag, launch = recorded
    graph = palp.start("launch", launch / "chain.yaml", "count:=1000000")
    wait_for_line(graph, "blocks: 1/")
    echo = ("topic", "echo", "/relay/amplified", "--field", "index", "--csv")
    live = int(palp.run(*echo, "--times", str(COUNT + 2)).stdout.split()[-1])
    palp.printed("swap", "source", "palp_core.graph.replay.player:Player", f"bag:={bag}", "rate:=0.02")
    assert int(palp.run(*echo, "--once").stdout) < COUNT < live


def test_in_lockstep_a_bag_as_the_source_gives_the_recorded_outputs(
    palp: Palp, recorded: tuple[Path, Path], tmp_path: Path
) -> None:
    bag, launch = recorded
    palp.printed("launch", launch / "again.yaml", f"bag:={bag}", "--record", tmp_path / "again")
    for topic in ("/source/sample", "/relay/amplified"):
        palp.printed("bag", "diff", bag, tmp_path / "again", "-t", topic)


def test_what_is_wrong_with_a_bag_in_a_launch_file_has_its_line(tmp_path: Path) -> None:
    file = tmp_path / "again.yaml"
    file.write_text(
        "graph: again\nclock: sim\nnodes:\n"
        "  source: {run: 'palp_core.graph.replay.player:Player', params: {bag: none}}\n"
    )
    with pytest.raises(PalpError, match=r"again.yaml:4:17: node 'source': .*none: no such bag"):
        check_here(file)


def test_wrong_words_are_refused_with_what_would_be_right(palp: Palp, recorded: tuple[Path, Path]) -> None:
    bag, _ = recorded
    wrong = (
        (("-m", "/source/sample"), "is not a remapping; write /node/port:=/other/port"),
        (("-m", "/no/such:=/a/b"), "/no/such is not among the topics that are played: /relay/amplified"),
        (("-m", "/source/sample:=/relay/amplified"), "two topics would be called /relay/amplified"),
        (("-t", "/sauce/sample"), "no topic '/sauce/sample'; did you mean '/source/sample'?"),
        (("-p",), "--start-paused needs a keyboard"),
        (("--start-offset", "100"), "no message of the chosen topics and time; the bag has 0.0"),
        (("--graph", "none"), "no graph named 'none' is running"),
    )
    for words, text in wrong:
        assert text in palp.refused("bag", "play", bag, *words)
