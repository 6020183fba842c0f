"""Where a publisher is, by its own word and by the run directory's."""

import contextlib
import os
from pathlib import Path

import pytest
import zmq

from palp_core.graph.discovery.run_directory import RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.discovery.topic_reader import TopicReader
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


@pytest.mark.parametrize(
    "story",
    [
        pytest.param([("prepare 1", "01"), ("gone 1", "1")], id="it is followed and the old place left"),
        pytest.param(
            [("relocate 1", "01"), ("prepare 2", "012"), ("gone 2", "02")],
            id="a place found otherwise is not left before its publisher moves on",
        ),
        pytest.param(
            [("prepare 1", "01"), ("relocate 1", "01"), ("stay 1", "0")],
            id="the run directory tells nothing new to who has followed",
        ),
        pytest.param(
            [
                *(("prepare 1", "01"), ("here 1", "01"), ("prepare 2", "012"), ("here 2", "012")),
                *(("gone 2", "012"), ("gone 1", "2"), ("gone 1", "2")),  # as it is said ten times a second
            ],
            id="a slow reader that hears of the next change first leaves nobody who speaks",
        ),
        pytest.param(
            [("prepare 1", "01"), ("prepare 2", "012"), ("gone 2", "2")],
            id="a place that was prepared and never spoke holds nothing up",
        ),
        pytest.param(
            [("prepare 1", "01"), ("here 1", "01"), ("tick 0", "01"), ("tick 1", "1")],
            id="an old place that dies without a word is given up",
        ),
    ],
)
def test_a_reader_listens_where_its_publisher_speaks(story: list[tuple[str, str]]) -> None:
    ear = Ear()
    found = following(ear)
    for event, places in story:
        verb, place = event.split()
        if verb == "relocate":
            found.relocate(TOPIC, f"ipc://{place}")
        elif verb == "tick":
            found.tick(GIVE_UP_NS + int(place))
        else:
            found.follow(moved(verb, place), 0)
        assert ear.at == {f"ipc://{one}" for one in places}, event
        if verb == "gone" and len(places) == 1:
            assert found.servers[TOPIC] == f"ipc://{places}.srv"


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


@pytest.mark.parametrize("reader", ["tool", "gateway"])
def test_a_reader_that_missed_a_move_reads_the_publisher_again(tmp_path: Path, reader: str) -> None:
    serve, name = f"ipc://{tmp_path}/graph.srv", f"ipc://{tmp_path}/a.pub"
    topic = Topic(name=TOPIC, type="T", type_hash="0", node="a", publish=name, json_schema={})
    graph = RunningGraph(RunRecord("g", "g.yaml", "wall", os.getpid(), 0, serve, [], [topic]))
    received: list[object] = []
    with TopicReader(graph, [topic]) as tool, contextlib.closing(EventLoop()) as event_loop:
        tap = Tap(event_loop, lambda _, frame: received.append(frame))
        tap.subscribe(TOPIC.encode(), name)
        arrive = tool._reader._arrive if reader == "tool" else tap._on_frame
        for phase in ("prepare", "gone"):
            arrive(raw_of(moved(phase, f"{tmp_path}/+1")), 0)
        publisher = event_loop.socket(zmq.PUB)
        publisher.bind(name)
        tap.migration.tick(LOOK_NS)
        for sequence in range(1, 1000):  # each turn waits a tenth of a second for something to come
            publisher.send(pack(TOPIC.encode(), Kind.DATA, 0, sequence, 0, 0))
            tool.turn(received.append) if reader == "tool" else event_loop.turn(0.1)
            if received:
                break
    assert received
