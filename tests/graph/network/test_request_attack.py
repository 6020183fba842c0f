"""Requests that mean harm, a hundred thousand at a node, at the launcher, at the door: answered or refused.

Nothing dies, nothing waits for ever, nothing grows. The default run keeps a few hundred of them.
"""

from __future__ import annotations

import contextlib
import random
import select
import socket
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgpack
import msgspec
import psutil
import pytest
import zmq

from palp_core import Message, Node, Params, Pub, Qos, Srv, Sub, on, serve
from palp_core.graph.messages.frame import pack
from palp_core.graph.network import join_protocol
from palp_core.graph.network.gateway import Gateway
from palp_core.graph.network.keys import KeyFolder
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Lifecycle
from palp_core.graph.node.loading import endpoints
from palp_core.graph.process.channel import MessageChannel
from palp_core.graph.process.node_services import CHANGING, NodeServices
from palp_core.graph.supervision.launcher_node import LauncherNode
from palp_core.graph.swap.swap import AskToSwap
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.graph.transport.request_server import REMEMBERED_BYTES
from tests.support.attack import Stranger
from tests.support.drive import Drive

GROWTH_BYTES = 48 << 20
NODE: dict[str, dict[str, Any]] = {
    "info": {"window": 5},
    "history": {"topic": "/n/declared", "first": 1, "last": 9},
    "schemas": {},
    "get_parameters": {},
    "describe_parameters": {},
    "set_parameters": {"parameters": {"offset": 2}},
    "call": {"service": "ask", "request": {"number": 1}},
    "transition": {"transition": "activate"},
    "publish": {"port": "hint", "message": {"number": 1}},
}
LAUNCHER: dict[str, dict[str, Any]] = {
    "graph": {},
    "clock": {},
    "info": {},
    "stop": {},
    "history": {"topic": "/graph/events", "first": 1, "last": 9},
    "swap": {"request": {"node": "n", "run": "m:C", "params": {"x": 1}, "timeout_s": 1.0}},
}


GUEST = {"name": "guest", "run": "m:C", "host": "h", "pid": 1}
WORDS: dict[str, dict[str, Any]] = {
    "hello": {"protocol": join_protocol.PROTOCOL},
    "join": {"request": {**GUEST, "outputs": {}, "inputs": {}, "reads_truth": False}},
    "clock": {"sent_ns": 5, "gateway_ns": 0},
    "subscribe": {"topic": "/n/declared", "wanted": True},
    "reply": {"envelope": [b"n", b"1"], "body": b"\x80"},
    "beat": {},
    "health": {"health": b"\x80"},
    "leave": {"text": "bye", "exit_code": 0},
    "refused": {"text": "no", "finished": True},
}


HELLO = msgpack.packb({"op": "hello", **WORDS["hello"]})
DECLARED: dict[str, Any] = dict.fromkeys(("node", "port", "type", "type_hash", "ros_text"), "0") | {
    "json_schema": {},
    "qos": {},
}


class Number(Message):
    number: int


class Numbers(Params):
    offset: int = 0


class Clerk(Node):
    params: Numbers
    hint = Sub(Number)
    told = Pub(Number, qos=Qos(depth=10))
    ask = Srv(Number, Number)

    @on(hint)
    def take(self, hint: Number) -> None:
        self.told.publish(hint)

    @serve(ask)
    def answer(self, question: Number) -> Number:
        return question


class Attacked:
    """Sockets that a stranger asks, and what does the work that was put off."""

    def __init__(self, sockets: NodeSockets, work: Callable[[], None]) -> None:
        self.sockets, self._work = sockets, work
        self.stranger: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.DEALER)
        self.stranger.connect(sockets.endpoints[1])

    def ask(self, burst: list[bytes]) -> list[dict[str, Any]]:
        for request in burst:
            self.stranger.send(request)
        replies: list[dict[str, Any]] = []
        while len(replies) < len(burst):
            self.sockets.poll()
            self._work()
            while self.stranger.poll(0 if replies else 1):
                replies.append(msgpack.unpackb(self.stranger.recv(), strict_map_key=False))
        return replies

    def __enter__(self) -> Attacked:
        return self

    def __exit__(self, *_: object) -> None:
        self.stranger.close(linger=0)


def attack(attacked: Attacked, operations: Mapping[str, Mapping[str, Any]], count: int) -> None:
    """Ask so many times; each is answered, by a map."""
    refused = asked = before_bytes = 0
    for burst in Stranger(operations).bursts(count):
        replies = attacked.ask(burst)
        assert all(isinstance(reply, dict) for reply in replies)
        asked += len(burst)
        refused += sum("error" in reply for reply in replies)
        if not before_bytes and asked > count / 4:
            before_bytes = psutil.Process().memory_info().rss
    assert 0.2 * asked < refused < asked
    assert not attacked.sockets.requests.waiting
    assert sum(map(len, attacked.sockets.requests.remembered.values())) <= REMEMBERED_BYTES
    assert psutil.Process().memory_info().rss - before_bytes < GROWTH_BYTES


def clerk(sockets: NodeSockets) -> Executor:
    """Return an active node that is asked there."""
    executor = Drive(Clerk, inputs={"hint": "/n/hint"}, external=["hint"]).executor
    sockets.requests.add("n", NodeServices(executor).operations(), CHANGING)
    return executor


COUNTS = pytest.mark.parametrize("count", [300, pytest.param(100_000, marks=pytest.mark.nightly)])


@pytest.fixture
def sockets(tmp_path: Path) -> Iterator[NodeSockets]:
    made = NodeSockets(f"ipc://{tmp_path}/p", f"ipc://{tmp_path}/s")
    yield made
    made.close()


@COUNTS
def test_a_node_answers_or_refuses_whatever_is_asked(sockets: NodeSockets, count: int) -> None:
    executor = clerk(sockets)
    with Attacked(sockets, sockets.requests.run_deferred) as attacked:
        attack(attacked, NODE, count)
    assert executor.lifecycle is Lifecycle.ACTIVE


@COUNTS
def test_the_launcher_answers_or_refuses_whatever_is_asked(tmp_path: Path, count: int) -> None:
    launcher = LauncherNode(str(tmp_path), lambda: 0)
    launcher.answer("stop", dict)
    launcher.defer("swap", AskToSwap, lambda asked: {"node": asked.request.node})
    with contextlib.closing(launcher), Attacked(launcher._sockets, launcher.run_deferred) as attacked:
        attack(attacked, LAUNCHER, count)


def test_ids_that_are_none_in_one_burst_with_repeated_ones_harm_nothing(sockets: NodeSockets) -> None:
    clerk(sockets)
    request = {"op": "set_parameters", "parameters": {"offset": 1}}
    tokens: list[Any] = [[], "a", "a"]
    burst = [msgpack.packb({**request, "id": token}) for token in tokens]
    with Attacked(sockets, sockets.requests.run_deferred) as attacked:
        refused, *answered = attacked.ask(burst)
    assert "id must be a text or null" in refused["error"]
    assert answered == [{"parameters": {"offset": 1}}] * 2


class Door:
    """A gateway's connections, a node and a launcher behind them, and a host that may come in.

    Args:
        folder: The run directory.
        work: Lets the node and the launcher have their turn.
    """

    def __init__(self, folder: Path, work: Callable[[], None]) -> None:
        self._work = work
        view = join_protocol.GraphView(graph="g", clock="wall", nodes=["n"], topics={})
        listen_on = join_protocol.ListenOn(
            run_dir=str(folder), endpoint="tcp://127.0.0.1:0", secured=False, view=view
        )
        self._launcher, theirs = socket.socketpair()
        self.gateway = Gateway(
            MessageChannel(theirs, msgspec.msgpack.Decoder(join_protocol.ToGateway)),
            listen_on,
            KeyFolder(folder),
        )
        self._host: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.DEALER)
        self._host.connect(self.gateway.endpoint)
        self._samples = 0

    def say(self, words: Iterable[list[bytes]]) -> None:
        """Say something, and then ask for the time, until that is answered."""
        self._samples += 1
        clock = {"op": "clock", "sent_ns": self._samples}
        for parts in [[HELLO], *words, [HELLO], [msgpack.packb(clock)]]:  # one of the words may be goodbye
            self._host.send_multipart(parts)
        self._until(lambda answer: answer["op"] == "clock" and answer["sent_ns"] == self._samples)

    def await_word(self, op: str) -> None:
        """Wait until the host receives this."""
        self._until(lambda answer: answer["op"] == op)

    def ask(self, body: bytes) -> dict[str, Any]:
        """Return what the launcher answers."""
        self._host.send(HELLO)
        self._host.send(msgpack.packb({"op": "request", "envelope": [b"7"], "node": "graph", "body": body}))
        answer = self._until(lambda answer: answer["op"] == "reply")
        return dict(msgpack.unpackb(answer["body"]))

    def refused(self, message: bytes) -> str:
        """Return with which text a message is refused."""
        self._host.send(HELLO)
        self._host.send(message)
        return str(self._until(lambda answer: answer["op"] == "refused")["text"])

    def _until(self, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        while True:
            self.gateway.turn(0.01)
            while select.select((self._launcher,), (), (), 0.0)[0]:
                self._launcher.recv(1 << 16)
            self._work()
            while self._host.poll(0):
                parts = self._host.recv_multipart()
                if parts[0][:1] != b"/" and wanted(answer := msgpack.unpackb(parts[0], strict_map_key=False)):
                    return dict(answer)

    def close(self) -> None:
        self._host.close(linger=0)
        self.gateway.event_loop.close()
        self.gateway._channel.close()
        self._launcher.close()


@pytest.fixture
def door(tmp_path: Path) -> Iterator[Door]:
    sockets = NodeSockets(*endpoints(str(tmp_path), "n"))
    launcher = LauncherNode(str(tmp_path), lambda: 0)
    executor = clerk(sockets)

    def work() -> None:
        sockets.poll()
        sockets.requests.run_deferred()
        launcher.poll()
        assert executor.lifecycle is Lifecycle.ACTIVE

    made = Door(tmp_path, work)
    yield made
    made.close()
    launcher.close()
    sockets.close()


def _frame(rng: random.Random, payload: bytes) -> bytes:
    topic = rng.choice((b"/guest/x", b"/n/declared", b"/graph/events", b"/" * 300, b"/guest/\xff"))
    words = rng.choice((0, 1, 2, 3, 77)), rng.choice((0, 1, 2**32 - 1)), rng.choice((0, 1, 2**53, 2**64 - 1))
    return pack(topic, words[0], words[1], words[2], rng.choice((0, -(2**63))), 7, payload)


@COUNTS
def test_the_door_answers_or_refuses_whatever_another_host_says(door: Door, count: int) -> None:
    rng = random.Random(2)
    said, asked = Stranger(WORDS), Stranger(NODE | LAUNCHER, seed=3)
    before_bytes = tickets = 0
    for words, bodies in zip(said.bursts(count), asked.bursts(10 * count), strict=False):
        tickets += len(bodies)
        requests = [
            {"op": "request", "envelope": [b"%d" % n], "node": rng.choice(("n", "graph", "x")), "body": body}
            for n, body in enumerate(bodies)
        ]
        frames = [[_frame(rng, body)] for body in bodies] + [[b"a", b"b", b"c"], [_frame(rng, b""), b"x"]]
        door.say([[word] for word in words] + frames + [[msgpack.packb(request)] for request in requests])
        if not before_bytes and tickets > count / 4:
            before_bytes = psutil.Process().memory_info().rss
    assert len(door.gateway.joined) <= 1
    assert psutil.Process().memory_info().rss - before_bytes < GROWTH_BYTES


def test_what_another_host_asks_is_read_as_a_request_at_the_door(door: Door) -> None:
    large = msgpack.packb({"op": "info", "more": bytes(1 << 20)})
    for body in (b"\x81\xa2op\xa1\xff", b"\x91" * 5000, b"\x80", b"", large):
        assert "error" in door.ask(body)
    for op in ("clock", "stop", "swap"):
        assert door.ask(msgpack.packb({"op": op}))["error"].endswith("another may only look")
    assert "error" not in door.ask(msgpack.packb({"op": "info"}))


def test_requests_that_wait_for_a_host_are_refused_when_it_leaves(door: Door, tmp_path: Path) -> None:
    door.say([[msgpack.packb({"op": "join", **WORDS["join"]})]])
    asker: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.DEALER)
    with contextlib.closing(asker):
        asker.connect(endpoints(str(tmp_path), "guest")[1])
        for number in range(2):
            asker.send(msgpack.packb({"op": "info", "id": number}))
        door.await_word("request")
        door.await_word("request")
        assert not asker.poll(0)
        door.say([[msgpack.packb({"op": "leave", "text": "bye", "exit_code": 0})]])
        for _ in range(2):
            assert asker.poll(10_000)
            assert "guest has left the graph" in msgpack.unpackb(asker.recv())["error"]


def test_topics_that_are_listened_to_no_longer_are_forgotten(door: Door) -> None:
    for n in range(10):
        for wanted in (True, False):
            door.say([[msgpack.packb({"op": "subscribe", "topic": f"/n/never{n}", "wanted": wanted})]])
    assert not door.gateway._tap._reorderers
    assert not door.gateway._tap.migration.servers
    door.say([[msgpack.packb({"op": "subscribe", "topic": "/n/" + "x" * 300})]])
    assert not door.gateway._tap._reorderers


@pytest.mark.parametrize(
    ("malformed", "words"),
    [
        (
            msgpack.packb({"op": "join", "request": {**GUEST, "pid": "x"}}),
            "request.pid must be a whole number",
        ),
        (msgpack.packb({"op": "join"}), "request is missing"),
        (msgpack.packb({"op": "join", "request": {**GUEST, "host": "h" * 5000}}), "request.host must be"),
        (msgpack.packb({"op": "nonsense"}), "nonsense"),
        (msgpack.packb({"op": "subscribe", "topic": "/x/y"}), "/x/y"),
        (b"\x81\xa2op", "not a message of this protocol"),
        (msgpack.packb({"op": "hello", "protocol": 99}), f"{join_protocol.PROTOCOL} of joining, not 99"),
        (
            msgpack.packb({"op": "join", "request": {**GUEST, "outputs": {"/n/declared": DECLARED}}}),
            "under its own name only",
        ),
    ],
)
def test_a_host_that_sends_a_malformed_join_is_answered_in_words(
    door: Door, malformed: bytes, words: str
) -> None:
    assert words in door.refused(malformed)
    door.say([[msgpack.packb({"op": "join", **WORDS["join"]})]])
    assert [request.name for request, _ in door.gateway.joined] == ["guest"]
