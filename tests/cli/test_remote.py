"""Asking a running graph's nodes: an answer, a refusal or silence within a bounded time; never a hang."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq

from palp_core.errors import GraphError
from palp_core.graph.discovery.run_directory import NodeEntry, RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.topic import Topic

Reply = dict[str, Any] | None


class FakeNode:
    """A ROUTER that answers, or does not."""

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self.requests: list[dict[str, Any]] = []
        self.replies: list[Reply] = []
        self._context = zmq.Context()
        self._stop = self._context.socket(zmq.PAIR)
        self._stop.bind("inproc://stop")
        router = self._context.socket(zmq.ROUTER)
        router.bind(endpoint)
        self._thread = threading.Thread(target=self._serve, args=(router,))
        self._thread.start()

    def _serve(self, router: zmq.Socket[bytes]) -> None:
        stop = self._context.socket(zmq.PAIR)
        stop.connect("inproc://stop")
        poller = zmq.Poller()
        for socket in (router, stop):
            poller.register(socket, zmq.POLLIN)
        while stop not in dict(poller.poll()):
            *envelope, payload = router.recv_multipart()
            self.requests.append(msgpack.unpackb(payload))
            reply = self.replies.pop(0) if self.replies else {"lifecycle": "active"}
            if reply is not None:
                router.send_multipart([*envelope, msgpack.packb(reply)])
        stop.close()
        router.close(0)

    def close(self) -> None:
        self._stop.send(b"")
        self._thread.join()
        self._stop.close()
        self._context.term()


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


@pytest.fixture
def node(tmp_path: Path) -> Iterator[FakeNode]:
    fake = FakeNode(f"ipc://{tmp_path}/relay.srv")
    yield fake
    fake.close()


def test_a_node_is_asked_by_name_with_or_without_the_slash(node: FakeNode, tmp_path: Path) -> None:
    graph = RunningGraph(record(tmp_path))
    for name in ("relay", "/relay"):
        assert graph.ask(name, "info") == {"lifecycle": "active"}
    assert [(r["op"], r["node"]) for r in node.requests] == [("info", "relay")] * 2


def test_a_refusal_is_an_error_that_names_the_node_once(node: FakeNode, tmp_path: Path) -> None:
    node.replies = [{"error": "relay: no operation 'x'"}]
    with pytest.raises(GraphError) as error:
        RunningGraph(record(tmp_path)).ask("relay", "x")
    assert str(error.value) == "/relay: no operation 'x'"


def test_a_lost_reply_is_asked_for_again_under_the_same_id(tmp_path: Path) -> None:
    replies: list[Reply] = [None, None, {"reply": {}}]
    requests: list[dict[str, Any]] = []

    def request(endpoint: str, asked: dict[str, Any], timeout_s: float) -> Reply:
        requests.append(asked)
        return replies.pop(0)

    assert RunningGraph(record(tmp_path), request).ask("relay", "call", retries=5) == {"reply": {}}
    assert len({request["id"] for request in requests}) == 1
    assert len(requests) == 3


def test_two_requests_have_two_ids(node: FakeNode, tmp_path: Path) -> None:
    graph = RunningGraph(record(tmp_path))
    for _ in range(2):
        graph.ask("relay", "call")
    assert len({request["id"] for request in node.requests}) == 2


def test_silence_is_an_error_that_says_how_long_and_what_the_process_does(
    node: FakeNode, tmp_path: Path
) -> None:
    node.replies = [None] * 9
    with pytest.raises(GraphError) as error:
        RunningGraph(record(tmp_path, os.getpid())).ask("relay", "info", timeout_s=0.05, retries=2)
    said = str(error.value)
    assert said.startswith("/relay did not answer 'info' within 0.05 s in any of 3 attempts")
    assert f"its process {os.getpid()} runs" in said
    assert str(tmp_path / "log" / "relay.log") in said


def test_a_node_whose_process_is_gone_is_said_to_be(tmp_path: Path) -> None:
    with pytest.raises(GraphError, match="its process 4194305 is gone"):
        RunningGraph(record(tmp_path, 4_194_305)).ask("relay", "info", timeout_s=0.0)


def test_one_silent_node_does_not_hide_the_others(tmp_path: Path) -> None:
    def request(endpoint: str, asked: dict[str, Any], timeout_s: float) -> Reply:
        return {"lifecycle": "active"} if asked["node"] == "relay" else None

    answers = RunningGraph(record(tmp_path), request).ask_all("info")
    assert list(answers.replies) == ["relay"]
    assert "/sink did not answer" in str(answers.silent["sink"])


def test_unknown_names_get_the_nearest_one(tmp_path: Path) -> None:
    graph = RunningGraph(record(tmp_path), lambda *_: {"services": {"tare": ["A", "B"]}})
    with pytest.raises(GraphError, match="did you mean '/relay'"):
        graph.node("raley")
    with pytest.raises(GraphError, match="did you mean '/relay/amplified'"):
        graph.topic("relay/amplifid")
    with pytest.raises(GraphError, match="did you mean '/relay/tare'"):
        graph.service("/relay/tear")
    with pytest.raises(GraphError, match="did you mean '/relay/tare'"):
        graph.service("/rely/tare")


def test_hidden_topics_are_known_without_asking_their_node(tmp_path: Path) -> None:
    graph = RunningGraph(record(tmp_path, nodes=("relay",)), lambda *_: pytest.fail("it was asked"))
    assert [topic.name for topic in graph.topics()] == ["/relay/amplified", "/relay/progress"]
    hidden = [topic.name for topic in graph.topics(include_hidden=True)][2:]
    assert hidden == ["/relay/_events", "/relay/_order"]
    assert "sources" in graph.topic("/relay/_order").json_schema["properties"]
