"""Asking a running graph's nodes: an answer, a refusal or silence within a bounded time; never a hang."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from palp_core.errors import GraphError
from palp_core.graph.discovery.run_directory import NodeEntry, RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.topic import Topic
from palp_core.graph.node.spec import HUNG_S
from palp_core.graph.swap.swap import Probation

Reply = dict[str, Any] | None


def record(folder: Path, pid: int = 0, nodes: tuple[str, ...] = ("relay", "sink")) -> RunRecord:
    def at(name: str) -> tuple[str, str]:
        return f"ipc://{folder}/{name}.pub", f"ipc://{folder}/{name}.srv"

    return RunRecord(
        graph="chain",
        file="chain.yaml",
        clock="wall",
        pid=os.getpid(),
        start_unix_ns=0,
        serve=f"ipc://{folder}/graph.srv",
        nodes=[NodeEntry(name, "nodes.relay:Relay", pid, *at(name)) for name in nodes],
        topics=[
            Topic(
                name=name,
                type="Sample",
                type_hash="0" * 16,
                node="relay",
                publish=at("relay")[0],
                json_schema={"type": "object", "properties": {}},
            )
            for name in ("/relay/amplified", "/relay/progress")
        ],
    )


def replying(requests: list[dict[str, Any]], *replies: Reply) -> Callable[..., Reply]:
    """Return what notes requests and gives replies, the last one again and again."""

    def request(endpoint: str, asked: dict[str, Any], timeout_s: float) -> Reply:
        requests.append(asked)
        return replies[min(len(requests), len(replies)) - 1]

    return request


def test_a_node_is_asked_by_name_with_or_without_the_slash_each_time_under_an_id(tmp_path: Path) -> None:
    requests: list[dict[str, Any]] = []
    graph = RunningGraph(record(tmp_path), replying(requests, {"lifecycle": "active"}))
    for name in ("relay", "/relay"):
        assert graph.ask(name, "info") == {"lifecycle": "active"}
    assert [(r["op"], r["node"]) for r in requests] == [("info", "relay")] * 2
    assert len({request["id"] for request in requests}) == 2


def test_a_lost_reply_is_asked_for_again_under_the_same_id(tmp_path: Path) -> None:
    requests: list[dict[str, Any]] = []
    graph = RunningGraph(record(tmp_path), replying(requests, None, None, {"reply": {}}))
    assert graph.ask("relay", "call", retries=5) == {"reply": {}}
    assert (len({request["id"] for request in requests}), len(requests)) == (1, 3)


@pytest.mark.parametrize(
    ("reply", "pid", "texts"),
    [
        ({"error": "relay: no operation 'x'"}, 0, ("/relay: no operation 'x'",)),
        (None, 4_194_305, ("its process 4194305 is gone",)),
        (
            None,
            os.getpid(),
            (
                "/relay did not answer 'info' within 0 s in any of 3 attempts",
                f"its process {os.getpid()} runs",
                "relay.log",
            ),
        ),
    ],
    ids=["refused", "gone", "silent"],
)
def test_a_refusal_or_silence_is_an_error_with_the_reason(
    reply: Reply, pid: int, texts: tuple[str, ...], tmp_path: Path
) -> None:
    with pytest.raises(GraphError) as error:
        RunningGraph(record(tmp_path, pid), replying([], reply)).ask(
            "relay", "info", timeout_s=0.0, retries=2
        )
    for text in texts:
        assert text in str(error.value)


def test_one_silent_node_does_not_hide_the_others(tmp_path: Path) -> None:
    def request(endpoint: str, asked: dict[str, Any], timeout_s: float) -> Reply:
        return {"lifecycle": "active"} if asked["node"] == "relay" else None

    answers = RunningGraph(record(tmp_path), request).ask_all("info")
    assert list(answers.replies) == ["relay"]
    assert "/sink did not answer" in str(answers.silent["sink"])
    of_none = RunningGraph(record(tmp_path, nodes=()), request).ask_all("info")  # all have yet to join
    assert of_none == ({}, {})


def test_unknown_names_get_the_nearest_one_and_hidden_topics_are_known_unasked(tmp_path: Path) -> None:
    graph = RunningGraph(record(tmp_path), lambda *_: {"services": {"tare": ["A", "B"]}})
    for find, name, nearest in (
        (graph.node, "raley", "/relay"),
        (graph.topic, "relay/amplifid", "/relay/amplified"),
        (graph.service, "/relay/tear", "/relay/tare"),
        (graph.service, "/rely/tare", "/relay/tare"),
    ):
        with pytest.raises(GraphError, match=f"did you mean '{nearest}'"):
            find(name)
    graph = RunningGraph(record(tmp_path, nodes=("relay",)), lambda *_: pytest.fail("it was asked"))
    names = [topic.name for topic in graph.topics(include_hidden=True)]
    assert names == ["/relay/amplified", "/relay/progress", "/relay/_events", "/relay/_order"]
    assert "sources" in graph.topic("/relay/_order").json_schema["properties"]


@pytest.mark.parametrize("clock", ["sim", "wall"])
def test_a_swap_is_waited_for_as_long_as_a_handler_on_probation_may_hang(
    clock: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waited_s: list[float] = []

    def silent(_: str, __: dict[str, Any], timeout_s: float) -> None:
        waited_s.append(timeout_s)

    record = RunRecord("toy", "toy.yaml", clock, 1, 0, f"ipc://{tmp_path}/graph.srv", [], [])
    monkeypatch.setattr(RunningGraph, "alive", True)
    with pytest.raises(GraphError, match="did not answer"):
        RunningGraph(record, silent).swap("relay", "nodes:Other", timeout_s=10.0)
    assert sum(waited_s) >= 10.0 + 10.0 + HUNG_S[clock]  # the probation has the time-out once more
    assert Probation().longest_s is None
