"""Requests that mean harm, a hundred thousand at a node, at the launcher, at the door: answered or refused.

Nothing dies, nothing waits for ever, nothing grows. The default run keeps a few hundred of them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgpack
import psutil
import pytest
import zmq

from palp_core import Message, Node, Params, Pub, Qos, Srv, Sub, on, serve
from palp_core.graph.clock import SimClock
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Lifecycle, Transition
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.process.node_services import CHANGING, NodeServices
from palp_core.graph.supervision.launcher_node import LauncherNode
from palp_core.graph.swap.swap import AskToSwap
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.graph.transport.request_server import REMEMBERED_BYTES
from tests.support.attack import Stranger

GROWTH_BYTES = 48 << 20
NODE = {
    "info": {"window": 5},
    "history": {"topic": "/n/told", "first": 1, "last": 9},
    "schemas": {},
    "get_parameters": {},
    "describe_parameters": {},
    "set_parameters": {"parameters": {"offset": 2}},
    "call": {"service": "ask", "request": {"number": 1}},
    "transition": {"transition": "activate"},
    "publish": {"port": "hint", "message": {"number": 1}},
}
LAUNCHER = {
    "graph": {},
    "clock": {},
    "info": {},
    "stop": {},
    "history": {"topic": "/graph/events", "first": 1, "last": 9},
    "swap": {"request": {"node": "n", "run": "m:C", "params": {"x": 1}, "timeout_s": 1.0}},
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
        self.stranger = zmq.Context.instance().socket(zmq.DEALER)
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
    spec = NodeSpec(name="n", run="m:N", inputs={"hint": "/n/hint"}, external=["hint"])
    executor = Executor(Clerk, spec, SimClock(), lambda _: None)
    executor.transition(Transition.CONFIGURE)
    executor.transition(Transition.ACTIVATE)
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
    with Attacked(sockets, sockets.requests.perform) as attacked:
        attack(attacked, NODE, count)
    assert executor.lifecycle is Lifecycle.ACTIVE


@COUNTS
def test_the_launcher_answers_or_refuses_whatever_is_asked(tmp_path: Path, count: int) -> None:
    launcher = LauncherNode(str(tmp_path), lambda: 0)
    launcher.answer("stop", lambda _: {})
    launcher.defer("swap", AskToSwap, lambda asked: {"node": asked.request.node})
    with contextlib.closing(launcher), Attacked(launcher._sockets, launcher.run_deferred) as attacked:
        attack(attacked, LAUNCHER, count)


def test_ids_that_are_none_in_one_burst_with_repeated_ones_harm_nothing(sockets: NodeSockets) -> None:
    clerk(sockets)
    request = {"op": "set_parameters", "parameters": {"offset": 1}}
    burst = [msgpack.packb({**request, "id": token}) for token in ([], "a", "a")]
    with Attacked(sockets, sockets.requests.perform) as attacked:
        refused, *answered = attacked.ask(burst)
    assert "`$.id`" in refused["error"]
    assert answered == [{"parameters": {"offset": 1}}] * 2
