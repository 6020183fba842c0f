"""Recorded nodes that speak again: types, rounds, times, bytes."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palp_core import Message
from palp_core.errors import BagError, NodeError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.bag.rounds import Rounds
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.messages.topic import Topic
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.replay.player import Player, playable, recorded_class, span_ns
from tests.graph.bag.test_reader import LAYOUTS
from tests.support.bags import Block, foreign_bag
from tests.support.drive import Drive

ROOT = Path(__file__).parents[3]


def messages_of_the_rig() -> list[type[Message]]:
    found = []
    for path in sorted((ROOT / "msgs").glob("*.py")):
        module = importlib.import_module(f"msgs.{path.stem}")
        for _, value in inspect.getmembers(module, inspect.isclass):
            if issubclass(value, Message) and value.__module__ == module.__name__:
                found.append(value)
    return found


def described(kind: type[Message], type_hash: str | None = None) -> Topic:
    schema = schema_of(kind)
    wanted = f"{schema.type_hash:016x}" if type_hash is None else type_hash
    return Topic(name="/a/b", type=schema.name, type_hash=wanted, json_schema=schema.json_schema)


def player_of(bag: Path, name: str = "torque", **params: float) -> Drive:
    return Drive(Player, name=name, run="", params={"bag": str(bag), **params})


def drive(bag: Path, name: str = "torque", **params: float) -> list[tuple[int, Any]]:
    """Run a player through its time; return when it sent which frame."""
    player, sent = player_of(bag, name, **params), list[tuple[int, Any]]()
    for _ in range(100_000):
        sent += [(player.clock.now_ns(), parse(raw)) for raw in player.frames if b"/_" not in raw[:60]]
        player.frames.clear()
        due_ns = player.executor.next_due_ns()
        if due_ns is None:
            break
        player.clock.set(max(due_ns, player.clock.now_ns()))
        player.executor.run_timers()
    assert player.executor.exit_code == 0
    player.executor.transition(Transition.SHUTDOWN)
    return sent


def test_a_class_from_the_schema_is_the_recorded_type() -> None:
    kinds: list[type[Message]] = [Block, *messages_of_the_rig()]
    for kind in kinds:
        made = recorded_class(described(kind))
        assert made is not kind
        assert schema_of(made).type_hash == schema_of(kind).type_hash, kind.__name__
        assert schema_of(made).json_schema == schema_of(kind).json_schema, kind.__name__


def test_a_schema_that_is_not_the_recorded_types_is_refused(kit: Any) -> None:
    with pytest.raises(BagError, match=r"type hash .* recorded was 0000000000000001"):
        recorded_class(described(kit.Block, f"{1:016x}"))
    with pytest.raises(BagError, match="have no palp schema"):
        recorded_class(Topic(name="/a/b"))
    with pytest.raises(BagError, match="is not a palp message's"):
        recorded_class(Topic(name="/a/b", json_schema={"type": "object", "properties": {"x": {}}}))


def test_a_player_sends_the_recorded_bytes_at_the_recorded_times(bag: Path) -> None:
    sent = drive(bag)
    with Bag(bag) as opened:
        recorded = list(opened.recorded(["/torque/block"]))
    assert [now_ns for now_ns, _ in sent] == [message.log_ns for message in recorded]
    assert [frame.stamp_ns for _, frame in sent] == [message.publish_ns for message in recorded]
    assert [bytes(frame.payload) for _, frame in sent] == [message.payload for message in recorded]
    assert [frame.sequence for _, frame in sent] == list(range(1, len(recorded) + 1))
    assert {f"{frame.type_hash:016x}" for _, frame in sent} == {recorded[0].stream.topic.type_hash}


def test_a_player_waits_for_room_before_each_message_that_a_reader_of_everything_needs(bag: Path) -> None:
    player = player_of(bag)
    executor = player.executor
    out = executor.ends.publishers["/torque/block"]
    published, waits = out.sequence, list[int]()

    def make_room() -> None:
        waits.append(out.sequence)
        out.room += 1

    out.room, out.wait_for_room = published, make_room
    player.clock.set(20_000_000)
    for _ in range(20):
        executor.run_timers()
    assert out.sequence > published + 10
    assert waits == list(range(published, out.sequence))
    executor.transition(Transition.SHUTDOWN)


def test_a_player_counts_from_the_first_message_of_the_whole_bag(bag: Path) -> None:
    sent = drive(bag, "policy", rate=0.5, start_offset_s=0.05)
    assert [now_ns for now_ns, _ in sent] == [100_000_000]  # the mode at 100 ms, half as fast, 50 ms left out


def test_a_player_offers_latched_topics_as_latched_and_only_nodes_of_the_bag(bag: Path) -> None:
    shaped: Any = Player.shaped("policy", {"bag": str(bag)})
    assert (shaped.mode.qos.durability, shaped.mode.qos.depth) == ("transient_local", 1)
    assert Player.shaped("stage", {}) is Player
    with pytest.raises(BagError, match=r"no messages of a node 'stage'.*policy, torque"):
        Player.shaped("stage", {"bag": str(bag)})


def test_a_player_that_takes_over_goes_on_where_the_other_was(bag: Path) -> None:
    player = player_of(bag)
    player.clock.set(20_000_000)
    for _ in range(20):
        player.executor.run_timers()
    follower = player.configured(Player)
    follower.take_over(player.executor.hand_over())
    player.clock.set(40_000_000)
    for _ in range(40):
        follower.run_timers()
    sequences = [frame.sequence for frame in map(parse, player.frames) if frame.topic == "/torque/block"]
    assert sequences == list(range(1, 42))
    follower.transition(Transition.SHUTDOWN)
    player.executor.transition(Transition.SHUTDOWN)


def test_what_can_be_played_is_what_nodes_published(kit: Any, tmp_path: Path) -> None:
    block = kit.Block(stamp_ns=0, torque_n_m=np.zeros(1))
    names = ("/torque/block", "/torque/_order", "/graph/events", "/torque/tare/panel/tare", "loose")
    frames = [(0, kit.frame(name, block, 1, 0)) for name in names]
    folder, _ = kit.record(tmp_path / "run", frames)
    with Bag(folder) as opened:
        assert list(playable(opened)) == ["/torque/block"]
        assert span_ns(opened) == (0, 0)


def test_a_file_that_was_never_closed_is_to_be_mended_first(bag: Path, tmp_path: Path) -> None:
    (file,) = bag.glob("*.mcap")
    with Bag(bag) as opened:
        whole = span_ns(opened)
        last = opened.files[0].chunks[-1]
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(file.read_bytes()[: last.offset + last.length])
    with Bag(torn) as opened:
        assert opened.files[0].statistics is None
        assert span_ns(opened) == whole
        with pytest.raises(BagError, match=r"torn\.mcap: it was not closed: .*: palp bag recover"):
            playable(opened)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_bag_of_any_layout_plays_to_its_last_message(layout: str, tmp_path: Path) -> None:
    found = [("/n/a", 1, i + 1, i * 1_000_000) for i in range(50)]
    options: dict[str, Any] = {"notes": {"latched_depth": "9999999"}, "chunk_size": 200, **LAYOUTS[layout]}
    path = foreign_bag(tmp_path / "other.mcap", found, "msgpack", **options)
    sent = drive(path, "n")
    assert [(now_ns, bytes(frame.payload)) for now_ns, frame in sent] == [
        (log_ns, b"\x80") for *_, log_ns in found
    ]
    with Bag(path) as opened:
        assert span_ns(opened) == (0, 49_000_000)


def test_what_cannot_be_played_is_refused_without_a_trace(
    bag: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = foreign_bag(tmp_path / "other.mcap", [("/n/a", 1, 1, 0)], "json")
    with pytest.raises(BagError, match="/n/a cannot be played: its messages are not msgpack"):
        Player.shaped("n", {"bag": str(path)})
    (file,) = bag.glob("*.mcap")
    data = bytearray(file.read_bytes())
    with Bag(bag) as opened:
        data[opened.files[0].chunks[3].offset + 90] ^= 1
    file.write_bytes(data)
    player = player_of(bag)
    player.clock.set(1_000_000_000)
    with pytest.raises(NodeError, match="a chunk is damaged"):
        player.executor.run_timers()
    player.node.on_shutdown()
    assert [record.exc_info for record in caplog.records if "is damaged" in record.getMessage()] == [None]


def test_rounds_put_an_answer_after_its_cause_and_keep_company_together() -> None:
    rounds = Rounds(
        ["experiment", "stage", "torque", "estimator"],
        {"estimator": ["/torque/block", "/experiment/trial"], "experiment": ["/estimator/belief"]},
    )
    instant = ["/stage/status", "/torque/block", "/estimator/belief", "/experiment/trial", "/stage/status"]
    assert [rounds(5, topic) for topic in instant] == [0, 0, 1, 2, 2]
    assert rounds(6, "/stage/status") == 0
    assert [Rounds()(7, topic) for topic in instant[:1]] == [0]


def test_a_bag_that_was_begun_later_counts_from_its_first_message(kit: Any, tmp_path: Path) -> None:
    late_ns = 7_000_000_000
    frames = [(late_ns + now_ns, raw) for now_ns, raw in kit.run_frames(3)]
    for folder, wanted, first_ns in (
        (tmp_path / "late", frames, 0),
        (tmp_path / "soon", kit.run_frames(3)[2:], 1),
    ):
        kit.record(folder, wanted)
        sent = drive(folder)
        assert sent[0][0] == first_ns * 1_000_000
