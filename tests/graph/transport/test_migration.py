"""Where a publisher is, by its own word and by the run directory's."""

from __future__ import annotations

import os
from pathlib import Path

import zmq

from palp_core.graph.discovery.run_directory import RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.discovery.topic_reader import ReceivedFrame, TopicReader
from palp_core.graph.messages.frame import Frame, Kind, pack, raw_of
from palp_core.graph.messages.message import encode_any
from palp_core.graph.messages.topic import Topic
from palp_core.graph.network.event_loop import EventLoop
from palp_core.graph.network.relay import Tap
from palp_core.graph.transport.migration import GIVE_UP_NS, LOOK_NS, Migration, Move

TOPIC = "/a/b"


class Ear:
    def __init__(self) -> None:
        self.at = {"ipc://0"}

    def connect(self, endpoint: str) -> None:
        self.at.add(endpoint)

    def disconnect(self, endpoint: str) -> None:
        self.at.discard(endpoint)


def moved(phase: str, to: str) -> Frame:
    payload = encode_any(Move(phase, f"ipc://{to}", f"ipc://{to}.srv"))
    return Frame(TOPIC, Kind.MOVED, 0, 7, 0, 0, memoryview(payload))


def following(ear: Ear) -> Migration:
    made = Migration(ear, {})
    made.add(TOPIC, "ipc://0", "")
    return made


def test_a_publisher_is_followed_to_its_new_place_and_the_old_one_left() -> None:
    ear = Ear()
    found = following(ear)
    found.follow(moved("prepare", "1"), 0)
    assert ear.at == {"ipc://0", "ipc://1"}
    found.follow(moved("gone", "1"), 0)
    assert ear.at == {"ipc://1"}
    assert found.servers[TOPIC] == "ipc://1.srv"


def test_who_missed_that_a_publisher_has_moved_on_listens_again_where_its_name_leads(tmp_path: Path) -> None:
    ear = Ear()
    found = following(ear)
    for phase in ("prepare", "gone"):
        found.follow(moved(phase, f"{tmp_path}/1"), 0)
    (tmp_path / "1").touch()
    found.tick(0)
    assert ear.at == {f"ipc://{tmp_path}/1"}
    (tmp_path / "1").unlink()
    found.tick(LOOK_NS)
    assert ear.at == {"ipc://0"}
    found.follow(moved("prepare", f"{tmp_path}/2"), 0)
    found.follow(moved("gone", f"{tmp_path}/2"), 0)
    assert ear.at == {f"ipc://{tmp_path}/2"}
    found.tick(2 * LOOK_NS)
    assert ear.at == {"ipc://0"}


def test_a_place_that_was_found_otherwise_is_not_left_when_the_publisher_moves_on() -> None:
    ear = Ear()
    found = following(ear)
    found.relocate(TOPIC, "ipc://1")  # its publisher's word came before this reader listened
    assert "ipc://1" in ear.at
    found.follow(moved("prepare", "2"), 0)
    assert {"ipc://1", "ipc://2"} <= ear.at
    found.follow(moved("gone", "2"), 0)
    assert "ipc://1" not in ear.at


def test_the_run_directory_tells_nothing_new_to_who_has_followed() -> None:
    ear = Ear()
    found = following(ear)
    found.follow(moved("prepare", "1"), 0)
    found.relocate(TOPIC, "ipc://1")
    found.follow(moved("stay", "1"), 0)
    assert ear.at == {"ipc://0"}


def test_a_slow_reader_that_hears_of_the_next_change_first_leaves_nobody_who_speaks() -> None:
    ear = Ear()
    found = following(ear)
    found.follow(moved("prepare", "1"), 0)
    found.follow(moved("here", "1"), 0)
    found.follow(moved("prepare", "2"), 0)  # of the second place; the first has said more than was read
    assert ear.at == {"ipc://0", "ipc://1", "ipc://2"}
    found.follow(moved("here", "2"), 0)
    found.follow(moved("gone", "2"), 0)
    assert {"ipc://0", "ipc://2"} <= ear.at
    found.follow(moved("gone", "1"), 0)
    found.follow(moved("gone", "1"), 0)  # as it is said ten times a second
    assert ear.at == {"ipc://2"}
    assert found.servers[TOPIC] == "ipc://2.srv"


def test_a_place_that_was_prepared_and_never_spoke_holds_nothing_up() -> None:
    ear = Ear()
    found = following(ear)
    found.follow(moved("prepare", "1"), 0)  # both processes died before they could say that it is off
    found.follow(moved("prepare", "2"), 0)
    found.follow(moved("gone", "2"), 0)
    assert ear.at == {"ipc://2"}


def test_an_old_place_that_dies_without_a_word_is_given_up() -> None:
    ear = Ear()
    found = following(ear)
    found.follow(moved("prepare", "1"), 0)
    found.follow(moved("here", "1"), 0)
    found.tick(GIVE_UP_NS)
    assert ear.at == {"ipc://0", "ipc://1"}
    found.tick(GIVE_UP_NS + 1)
    assert ear.at == {"ipc://1"}


def test_a_tool_that_missed_a_move_hears_the_publisher_again(tmp_path: Path) -> None:
    serve, name = f"ipc://{tmp_path}/graph.srv", f"ipc://{tmp_path}/a.pub"
    topic = Topic(name=TOPIC, type="T", type_hash="0", node="a", publish=name, json_schema={})
    graph = RunningGraph(RunRecord("g", "g.yaml", "wall", os.getpid(), 0, serve, [], [topic]))
    heard: list[ReceivedFrame] = []
    with TopicReader(graph, [topic]) as reader, zmq.Context() as context:
        for phase in ("prepare", "gone"):
            reader._reader._arrive(raw_of(moved(phase, f"{tmp_path}/+1")), 0)
        publisher = context.socket(zmq.PUB)
        publisher.bind(name)
        for sequence in range(1, 1000):  # each turn waits a tenth of a second for something to come
            publisher.send(pack(TOPIC.encode(), Kind.DATA, 0, sequence, 0, 0))
            reader.turn(heard.append)
            if heard:
                break
        publisher.close(linger=0)
    assert heard


def test_a_gateway_that_missed_a_move_hears_the_publisher_again(tmp_path: Path) -> None:
    heard: list[list[bytes]] = []
    event_loop = EventLoop()
    tap = Tap(event_loop, lambda _, parts: heard.append(parts))
    tap.subscribe(TOPIC.encode(), f"ipc://{tmp_path}/a.pub")
    for phase in ("prepare", "gone"):
        tap._on_frame([raw_of(moved(phase, f"{tmp_path}/+1"))])
    publisher = event_loop.socket(zmq.PUB)
    publisher.bind(f"ipc://{tmp_path}/a.pub")
    tap.tick(LOOK_NS)
    for sequence in range(1, 1000):  # each turn waits a tenth of a second for something to come
        publisher.send(pack(TOPIC.encode(), Kind.DATA, 0, sequence, 0, 0))
        event_loop.turn(0.1)
        if heard:
            break
    event_loop.close()
    assert heard
