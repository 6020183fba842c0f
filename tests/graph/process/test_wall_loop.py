"""A node waits for no launcher: what that cannot take is shown later, or not if others follow."""

from __future__ import annotations

import socket
from collections import deque
from types import SimpleNamespace

import msgspec

from palp_core.graph.process.channel import MessageChannel
from palp_core.graph.process.control_messages import Relay, ToNode
from palp_core.graph.process.wall_loop import WallLoop


def test_what_a_launcher_that_does_not_keep_up_is_to_show_waits_and_passing_news_is_left_out() -> None:
    ours, theirs = socket.socketpair()
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
    published: list[bytes] = []
    loop = object.__new__(WallLoop)  # what relays, without a node
    loop.sockets = SimpleNamespace(publisher=SimpleNamespace(send=published.append))  # type: ignore[assignment]
    loop.channel = MessageChannel(ours, msgspec.msgpack.Decoder(ToNode))
    loop._unrelayed = deque()
    while loop._supervisor_keeps_up():
        loop._publish_and_relay(bytes(100), passing=True)
    shown_count = len(published)
    for number in (1, 2):
        loop._publish_and_relay(b"stays %d" % number, passing=False)
        loop._publish_and_relay(b"passes %d" % number, passing=True)
    assert published[shown_count:] == [b"stays 1", b"passes 1", b"stays 2", b"passes 2"]
    launcher = MessageChannel(theirs, msgspec.msgpack.Decoder(Relay))
    assert [launcher.receive().frame for _ in range(shown_count)] == [bytes(100)] * shown_count
    loop._relay()
    assert [launcher.receive().frame for _ in range(2)] == [b"stays 1", b"stays 2"]
    assert not launcher.buffered()
    ours.close()
    theirs.close()
