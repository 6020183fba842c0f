"""Requests that change something wait their turn, but not for one that takes long."""

from collections.abc import Iterator
from typing import Any

import msgpack
import pytest
import zmq

from palp_core.graph.transport.request_server import (
    TOO_MANY_REPLIES,
    NodeOperation,
    NodeRequest,
    RequestServer,
)
from palp_core.graph.transport.zmq_sockets import InFlightBytes
from tests.support.palp import PATIENCE_S, short_folder


class Desk:
    """A server, and a client that asks it."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], endpoint: str) -> None:
        self.server = RequestServer(context, endpoint)
        self.asker = context.socket(zmq.DEALER)
        self.asker.setsockopt(zmq.RCVHWM, 1)
        self.asker.connect(endpoint)

    def ask(self, operation: str, **fields: Any) -> None:
        self.asker.send(msgpack.packb({"op": operation, **fields}))

    def reply(self) -> dict[str, Any]:
        assert self.asker.poll(round(PATIENCE_S * 1e3))
        return dict(msgpack.unpackb(self.asker.recv()))


@pytest.fixture
def desk() -> Iterator[Desk]:
    with short_folder() as folder, zmq.Context() as context:
        yield Desk(context, f"ipc://{folder}/srv")
        context.destroy(linger=0)


def test_what_came_with_one_that_takes_long_does_not_wait_for_it(desk: Desk) -> None:
    begun: list[str] = []

    def swap(request: NodeRequest) -> dict[str, Any]:
        if begun:
            return {"said": "busy"}
        begun.append("begun")
        desk.server.poll()  # as the launcher does while it waits for others
        assert desk.reply() == {"said": "busy"}
        return {"said": "done"}

    desk.server.add("_launcher", {"swap": NodeOperation(NodeRequest, swap)}, {"swap"})
    for token in ("first", "second"):
        desk.ask("swap", node="_launcher", id=token)
    while len(desk.server._waiting) < 2:
        desk.server.poll()
    desk.server.run_deferred()
    assert desk.reply() == {"said": "done"}
    assert set(desk.server.remembered) == {"first", "second"}
    assert not desk.server.waiting


def test_a_request_that_waited_is_answered_by_who_has_the_nodes_place_by_then(desk: Desk) -> None:
    def says(word: str) -> NodeOperation[NodeRequest]:
        return NodeOperation(NodeRequest, lambda _: {"said": word})

    desk.server.add("policy", {"set": says("the new one")}, {"set"})
    desk.ask("set", node="policy")
    while not desk.server.waiting:
        desk.server.poll()
    desk.server.add("policy", {"set": says("the old one again")}, {"set"})
    desk.server.run_deferred()
    assert desk.reply() == {"said": "the old one again"}


def test_replies_that_nobody_takes_are_bounded_in_bytes_and_each_request_is_answered(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(desk.server, "_in_flight", InFlightBytes(1 << 20))
    desk.server.add("n", {"large": NodeOperation(NodeRequest, lambda _: {"bytes": bytes(256 << 10)})})
    answered: list[bytes] = []
    send = desk.server._send

    def note(envelope: list[bytes], reply: bytes) -> None:
        send(envelope, reply)
        answered.append(reply)

    monkeypatch.setattr(desk.server, "_send", note)
    for _ in range(60):
        desk.ask("large")
    while len(answered) < 60:
        desk.server.poll(1)
        assert desk.server._in_flight._total <= 1 << 20
    refused = [reply["error"] for reply in (desk.reply() for _ in range(60)) if "error" in reply]
    assert set(refused) == {TOO_MANY_REPLIES}
    assert len(refused) >= 40
