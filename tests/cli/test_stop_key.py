"""The key that stops: read on a terminal, which is as before afterwards; and whom it calls."""

from __future__ import annotations

import fcntl
import os
import queue
import struct
import termios
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from typer.testing import CliRunner

from palp_core.cli.launch.stop_key import StopKey, stop_motion
from palp_core.cli.session import app
from palp_core.cli.session.operate import Desk, effort_line
from palp_core.errors import GraphError
from palp_core.graph.discovery.run_directory import NodeEntry, RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph, safety_node
from palp_core.graph.messages.frame import Frame, Kind, pack, parse
from palp_core.graph.messages.topic import Topic
from palp_core.palpation.session.human.questions import IDENTITY


def wait_until_read(slave: int) -> None:
    """Wait until nothing waits in the terminal any more: the reader has taken it."""
    while struct.unpack("i", fcntl.ioctl(slave, termios.FIONREAD, b"\0" * 4))[0]:
        threading.Event().wait(0.001)


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    master, slave = os.openpty()
    yield master, slave
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize(
    "typed",
    [[b"x", b" "], [b"\xe9", b" "], [b"\x1b[ "]],
    ids=["another key", "bytes that are no text", "within what looks like another key"],
)
def test_a_press_counts_once_and_other_keys_do_not(terminal: tuple[int, int], typed: list[bytes]) -> None:
    master, slave = terminal
    presses: queue.Queue[str] = queue.Queue()
    key = StopKey(slave, lambda: presses.put("pressed"))
    assert key.start()
    for some in typed:
        os.write(master, some)
        wait_until_read(slave)
    assert presses.get() == "pressed"
    key.stop()
    assert presses.empty()


def test_the_safety_node_is_found_by_what_it_publishes() -> None:
    asked: list[dict[str, Any]] = []

    def answer(endpoint: str, request: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        asked.append({"endpoint": endpoint, **request})
        return {"reply": {"state": "tripped", "cause": "operator"}}

    node = NodeEntry("guard", "nodes.safety:Safety", 1, "ipc:///run/guard.pub", "ipc:///run/guard.srv")
    beat = Topic(
        name="/guard/beat", type="SafetyBeat", type_hash="0" * 16, node="guard", publish=node.publish
    )
    record = RunRecord("rig", "rig.yaml", "wall", 1, 0, "ipc:///run/graph.srv", [node], [beat])
    reply = stop_motion(RunningGraph(record, answer), "a test", 1.0)
    assert reply == {"state": "tripped", "cause": "operator"}
    assert [(a["endpoint"], a["service"], a["request"]) for a in asked] == [
        (node.serve, "stop", {"reason": "a test"})
    ]
    without = RunRecord("toy", "toy.yaml", "wall", 1, 0, "ipc:///run/graph.srv", [], [])
    with pytest.raises(GraphError, match="has no safety node"):
        stop_motion(RunningGraph(without), "a test", 1.0)


@pytest.mark.parametrize(
    ("names", "beating", "expected"),
    [
        (["stage", "guard"], ["guard"], "guard"),
        (["replica", "safety"], ["replica", "safety"], "safety"),
        (["stage", "safety"], [], "safety"),
        (["guard", "safety"], ["guard"], "guard"),
        (["stage"], [], None),
    ],
)
def test_of_several_nodes_or_none_that_beat_the_name_decides(
    names: list[str], beating: list[str], expected: str | None
) -> None:
    assert safety_node([(name, "SafetyBeat") for name in beating], names) == expected


def test_the_terminal_is_as_before_and_without_one_there_is_no_key(terminal: tuple[int, int]) -> None:
    _, slave = terminal
    with Path(os.devnull).open() as no_terminal:
        assert not StopKey(no_terminal.fileno(), lambda: None).start()
    before = termios.tcgetattr(slave)
    key = StopKey(slave, lambda: None)
    key.start()
    assert not termios.tcgetattr(slave)[3] & termios.ICANON
    key.stop()
    assert termios.tcgetattr(slave) == before


PROMPT = Topic(name="/session/prompt", type="Prompt", node="session")
COUNT = Topic(name="/session/countdown", type="Countdown", node="session")


class Graph:
    """A running graph that takes what it is asked."""

    alive = True

    def __init__(self, *, taken: bool = True) -> None:
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.taken = taken

    def ask(self, node: str, operation: str, **fields: Any) -> dict[str, Any]:
        assert operation == "call"
        self.asked.append((node, fields["request"]))
        return {"reply": {"taken": self.taken, "text": "" if self.taken else "not this"}}


def frame(topic: Topic, **fields: Any) -> Frame:
    return parse(pack(topic.name.encode(), Kind.DATA, 0, 1, 0, 0, msgspec.msgpack.encode(fields)))


def prompt(number: int, kind: str, text: str = "What?", choices: tuple[str, ...] = ()) -> Frame:
    return frame(PROMPT, number=number, kind=kind, text=text, choices=choices, ends_ns=0)


@pytest.fixture
def graph() -> Graph:
    return Graph()


@pytest.fixture
def desk(graph: Graph) -> Desk:
    return Desk(graph, [PROMPT, COUNT], 1.0)  # type: ignore[arg-type]


def test_what_is_asked_is_shown_and_answered_by_its_number(
    desk: Desk, graph: Graph, capsys: pytest.CaptureFixture[str]
) -> None:
    desk.show(prompt(3, "choice", "How deep?", ("2", "4")))
    assert "How deep? [2 / 4]" in capsys.readouterr().out
    desk.answer("4")
    assert graph.asked == [("session", {"number": 3, "text": "4", "by": "terminal"})]
    graph.taken = False
    desk.answer("x")
    assert "not this" in capsys.readouterr().err
    desk.show(prompt(4, "none", "Thank you."))
    desk.answer("")
    assert len(graph.asked) == 2
    assert "nothing is asked" in capsys.readouterr().err


def test_a_name_does_not_leave_the_terminal(
    desk: Desk, graph: Graph, capsys: pytest.CaptureFixture[str]
) -> None:
    for kind in ("subject", "consent"):
        desk.show(prompt(1, "text", IDENTITY[kind]))
        desk.answer("Anna Mueller")
        assert graph.asked == []
        text = capsys.readouterr().err
        assert "code" in text
        assert "Anna" not in text
    desk.answer("C-17")
    assert len(graph.asked) == 1


def test_time_and_effort_are_shown(desk: Desk, capsys: pytest.CaptureFixture[str]) -> None:
    desk.show(frame(COUNT, what="palpation", left_s=41.0, of_s=60.0))
    assert "palpation: 41 s left" in capsys.readouterr().out
    assert effort_line({"fds": 0.5, "edc": 1.4, "clipped": True}).endswith("CLIPPED")


def test_the_plan_is_shown_without_a_rig() -> None:
    done = CliRunner().invoke(app, ["plan"])
    assert "training: 15 trials, A 5 times, B 5 times, C 5 times" in done.stdout
    assert "15 questions" in done.stdout
