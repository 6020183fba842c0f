"""The doctor: each fault of a graph is found, with place and advice, and a healthy graph has none."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest

from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.discovery.troubles import Trouble, examine_graph
from palp_core.graph.messages.builtin import GraphEvent, NodeEvent
from palp_core.graph.messages.frame import Kind, pack
from palp_core.graph.messages.message import encode
from palp_core.graph.messages.qos import Qos
from tests.cli.test_remote import record

TOPIC = "/relay/amplified"
EDGE = f"{TOPIC} -> /sink"
ACCOUNT = dict.fromkeys(("received", "lost", "repeated", "late", "dropped", "filled"), 0)


def qos(**changes: Any) -> dict[str, Any]:
    plain: dict[str, Any] = msgspec.to_builtins(Qos(**changes))
    return plain


def relay(**changes: Any) -> dict[str, Any]:
    outputs = {TOPIC: {"type": "Sample", "sequence": 9, "qos": qos()}}
    info = {"lifecycle": "active", "outputs": outputs, "inputs": {}, "published": {TOPIC: 9}, "ticks": 9}
    return info | changes


def sink(account: dict[str, Any] | None = None, **changes: Any) -> dict[str, Any]:
    account = ACCOUNT | {"received": 9, "port": "sample", "qos": qos(), "latency_s": None} | (account or {})
    return {"lifecycle": "active", "inputs": {TOPIC: account}, "outputs": {}, "published": {}} | changes


def findings(
    tmp_path: Path, launcher_said: Sequence[bytes] | None = (), **nodes: dict[str, Any] | None
) -> list[Trouble]:
    def request(endpoint: str, asked: dict[str, Any], timeout_s: float) -> dict[str, Any] | None:
        if asked["op"] == "history":
            frames = frames_of.get(asked["node"], [])
            return None if frames is None else {"frames": frames}
        return nodes.get(asked["node"])

    frames_of = {"sink": [EVENT], "graph": launcher_said}
    return list(examine_graph(RunningGraph(record(tmp_path, os.getpid()), request)))


def restarting(sequence: int) -> bytes:
    event = GraphEvent(stamp_ns=0, kind="restarting", node="relay", text="it was killed", data="{}")
    return pack(b"/graph/events", Kind.DATA, 0, sequence, 0, 0, encode(event))


EVENT = pack(
    b"/sink/_events",
    Kind.DATA,
    0,
    1,
    0,
    0,
    encode(
        NodeEvent(stamp_ns=0, kind="deadline", text="no message within its deadline", data='{"port": "x"}')
    ),
)


def test_a_healthy_graph_has_nothing_to_find(tmp_path: Path) -> None:
    assert {finding.level for finding in findings(tmp_path, relay=relay(), sink=sink())} == {"ok"}


FAULTS: list[tuple[dict[str, Any], dict[str, Any] | None, str, str, str]] = [
    ({}, None, "error", "/sink", "/sink did not answer"),
    ({}, {"lost": 3}, "error", EDGE, "3 messages lost"),
    ({}, {"lost": 3, "qos": qos(reliability="best_effort")}, "warn", EDGE, "3 messages lost"),
    (
        {"published": {TOPIC: 5000}},
        {"sequence": 400, "rate_hz": 96.0},
        "warn",
        EDGE,
        "4600 messages wait",
    ),
    ({}, {"late": 2}, "warn", EDGE, "2 messages late"),
    ({}, {"dropped": 2}, "warn", EDGE, "2 messages dropped"),
    ({}, {"repeated": 2}, "note", EDGE, "2 messages came more"),
    ({"lifecycle": "inactive"}, {}, "warn", "/relay", "is inactive"),
    ({"overruns": 5, "ticks": 10}, {}, "warn", "/relay", "5 of 10 ticks"),
    ({"overruns": 1, "ticks": 10**6}, {}, "note", "/relay", "1 of 1000000 ticks"),
    ({"rejected": 4}, {}, "warn", "/relay", "4 frames were refused"),
    ({"unread": 4000}, {}, "warn", "/relay", "4000 messages wait"),
    ({}, {"events": 1}, "warn", "/sink", "no message within its deadline"),
]
"""What the relay differs in, the sink's account, and what is found."""


@pytest.mark.parametrize(("relays", "account", "level", "where", "what"), FAULTS)
def test_a_fault_is_found_with_place_and_advice(
    tmp_path: Path, relays: dict[str, Any], account: dict[str, Any] | None, level: str, where: str, what: str
) -> None:
    events = {} if account is None or "events" not in account else {"published": {"/sink/_events": 1}}
    sinks = None if account is None else sink(account, **events)
    bad = [
        finding for finding in findings(tmp_path, relay=relay(**relays), sink=sinks) if finding.level != "ok"
    ]
    assert [(f.level, f.where) for f in bad] == [(level, where)]
    assert what in bad[0].text
    assert bad[0].advice or bad[0].command or level == "note"


@pytest.mark.parametrize(
    "account", [{"sequence": 4500, "rate_hz": 1000.0}, {"epoch": -1, "sequence": 0}], ids=["asked", "joined"]
)
def test_who_was_asked_a_moment_earlier_or_has_just_joined_is_not_behind(
    tmp_path: Path, account: dict[str, Any]
) -> None:
    found = findings(tmp_path, relay=relay(published={TOPIC: 5000}), sink=sink(account))
    assert not [finding for finding in found if finding.level != "ok"]


def test_what_the_launcher_had_to_say_is_found(tmp_path: Path) -> None:
    events = [restarting(1), restarting(2)]
    bad = [f for f in findings(tmp_path, events, relay=relay(), sink=sink()) if f.level != "ok"]
    assert [(f.level, f.where) for f in bad] == [("warn", "/relay")]
    assert bad[0].text == "restarting: it was killed (2 such events remembered)"


def test_a_launcher_that_does_not_answer_is_an_error(tmp_path: Path) -> None:
    bad = [f for f in findings(tmp_path, None, relay=relay(), sink=sink()) if f.level != "ok"]
    assert [f.level for f in bad] == ["error"]
    assert "its launcher: /graph did not answer" in bad[0].text
