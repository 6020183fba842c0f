"""A node waits for no launcher: what that cannot take is shown later, or not if others follow."""

from __future__ import annotations

import os
import socket
from collections import deque
from pathlib import Path
from types import SimpleNamespace

import msgspec

from palp_core import Alarm, Node, on
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.process.channel import MessageChannel
from palp_core.graph.process.control_messages import Relay, Spawn, ToNode
from palp_core.graph.process.wall_loop import WallLoop


class Waiting(Node):
    """Wait on a descriptor, and count what rings."""

    bell = Alarm()
    rung = 0

    @on(bell)
    def ring(self) -> None:
        self.rung += 1


def test_an_alarm_rings_once_when_a_file_descriptor_of_its_is_readable(tmp_path: Path) -> None:
    ours, theirs = socket.socketpair()
    out, into = os.pipe()
    spec, folder = NodeSpec(name="w", run=f"{__name__}:Waiting"), str(tmp_path)
    order = Spawn(spec=spec, clock="wall", run_dir=folder, workspace=folder, log=f"{folder}/log", place="w")
    loop = WallLoop(order, MessageChannel(ours, msgspec.msgpack.Decoder(ToNode)))
    loop.executor.transition(Transition.ACTIVATE)
    node: Waiting = loop.executor.node  # type: ignore[assignment]
    node.bell.set(1 << 62, (out,))
    loop._wait()
    loop.executor.run_timers()
    assert node.rung == 0
    os.write(into, b"!")
    for _ in range(2):
        loop._wait()
        loop.executor.run_timers()
    assert (node.rung, node.bell.due_ns, node.bell.file_descriptors) == (1, None, ())
    loop.close()
    for end in (out, into):
        os.close(end)
    ours.close()
    theirs.close()


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
