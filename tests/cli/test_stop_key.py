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

import pytest

from palp_core.cli.launch.stop_key import StopKey, stop_motion
from palp_core.errors import GraphError
from palp_core.graph.discovery.run_directory import NodeEntry, RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph, safety_node
from palp_core.graph.messages.topic import Topic


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
