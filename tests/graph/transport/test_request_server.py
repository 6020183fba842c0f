"""Requests that change something wait their turn, but not for one that takes long."""

from __future__ import annotations

from typing import Any

import msgpack
import zmq

from palp_core.graph.transport.request_server import NodeOperation, NodeRequest, RequestServer
from tests.support.palp import short_folder


def test_what_came_with_one_that_takes_long_does_not_wait_for_it() -> None:
    said: list[str] = []

    def swap(request: NodeRequest) -> dict[str, Any]:
        if said:
            return {"said": "busy"}
        said.append("begun")
        server.poll()  # as the launcher does while it waits for others
        assert asker.poll(10_000)
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
        assert asker.poll(10_000)
        assert msgpack.unpackb(asker.recv()) == {"said": "done"}
        assert set(server.remembered) == {"first", "second"}
        assert not server.waiting
        context.destroy(linger=0)
