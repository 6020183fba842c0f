"""Requests that change something wait their turn, but not for one that takes long."""

from typing import Any

import msgpack
import pytest
import zmq

from palp_core.graph.transport import request_server
from palp_core.graph.transport.request_server import NodeOperation, NodeRequest, RequestServer
from tests.support.palp import PATIENCE_S, short_folder

PATIENCE_MS = round(PATIENCE_S * 1e3)


def test_what_came_with_one_that_takes_long_does_not_wait_for_it() -> None:
    said: list[str] = []

    def swap(request: NodeRequest) -> dict[str, Any]:
        if said:
            return {"said": "busy"}
        said.append("begun")
        server.poll()  # as the launcher does while it waits for others
        assert asker.poll(PATIENCE_MS)
        assert msgpack.unpackb(asker.recv()) == {"said": "busy"}
        return {"said": "done"}

    with short_folder() as folder, zmq.Context() as context:
        server = RequestServer(context, f"ipc://{folder}/srv")
        server.add("_launcher", {"swap": NodeOperation(NodeRequest, swap)}, {"swap"})
        asker = context.socket(zmq.DEALER)
        asker.connect(f"ipc://{folder}/srv")
        for token in ("first", "second"):
            asker.send(msgpack.packb({"op": "swap", "node": "_launcher", "id": token}))
        while len(server._waiting) < 2:
            server.poll()
        server.perform()
        assert asker.poll(PATIENCE_MS)
        assert msgpack.unpackb(asker.recv()) == {"said": "done"}
        assert set(server.remembered) == {"first", "second"}
        assert not server.waiting
        context.destroy(linger=0)


def test_a_request_that_waited_is_answered_by_who_has_the_nodes_place_by_then() -> None:
    def says(word: str) -> NodeOperation[NodeRequest]:
        return NodeOperation(NodeRequest, lambda _: {"said": word})

    with short_folder() as folder, zmq.Context() as context:
        server = RequestServer(context, f"ipc://{folder}/srv")
        server.add("policy", {"set": says("the new one")}, {"set"})
        asker = context.socket(zmq.DEALER)
        asker.connect(f"ipc://{folder}/srv")
        asker.send(msgpack.packb({"op": "set", "node": "policy"}))
        while not server.waiting:
            server.poll()
        server.add("policy", {"set": says("the old one again")}, {"set"})
        server.perform()
        assert asker.poll(PATIENCE_MS)
        assert msgpack.unpackb(asker.recv()) == {"said": "the old one again"}
        context.destroy(linger=0)


def test_replies_that_nobody_takes_are_bounded_in_bytes_and_each_request_is_answered(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(request_server, "REPLY_BYTES", 1 << 20)
    large = NodeOperation(NodeRequest, lambda _: {"bytes": bytes(256 << 10)})
    with short_folder() as folder, zmq.Context() as context:
        server = RequestServer(context, f"ipc://{folder}/srv")
        server.add("n", {"large": large})
        asker = context.socket(zmq.DEALER)
        asker.setsockopt(zmq.RCVHWM, 1)
        asker.connect(f"ipc://{folder}/srv")
        answered: list[bytes] = []
        send = server._send

        def note(envelope: list[bytes], reply: bytes) -> None:
            send(envelope, reply)
            answered.append(reply)

        monkeypatch.setattr(server, "_send", note)
        for _ in range(60):
            asker.send(msgpack.packb({"op": "large"}))
        while len(answered) < 60:
            server.poll(1)
            assert server._in_flight._total <= 1 << 20
        replies = [msgpack.unpackb(asker.recv()) for _ in range(60)]
        refused = [reply["error"] for reply in replies if "error" in reply]
        assert set(refused) == {"too many large replies wait to be taken; take them and ask again"}
        assert len(refused) >= 40
        context.destroy(linger=0)
