"""What comes into a node on the wall clock goes to its handler at once where it may, and else in its turn."""

import select
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import zmq

from palp_core import Message, Node, Qos, QosEvent, State, Sub, on, on_event
from palp_core.graph.clock import SimClock
from palp_core.graph.messages.frame import Kind, pack
from palp_core.graph.messages.message import encode
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.process.channel import MessageChannel
from palp_core.graph.process.control_messages import Spawn, ToNode
from palp_core.graph.process.wall_loop import WallLoop
from palp_core.graph.transport import publisher_socket
from palp_core.graph.transport import receiver as receiver_module
from palp_core.graph.transport.acks import ACK
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.graph.transport.receiver import MOST_UNREAD_BYTES, TopicReceiver
from palp_core.graph.transport.subscriber_socket import ARRAY_QUEUE
from palp_core.units import RatioArray
from tests.graph.transport.test_publisher_socket import Owner

DEADLINE_MS = 10.0
WHILE_BUSY_NS = 35_000_000


class Word(Message):
    n: int


class HeardState(State):
    heard: list[str] = []


class Reader(Node):
    state: HeardState
    word = Sub(Word)

    @on(word)
    def take(self, word: Word) -> None:
        self.state.heard.append(f"word {word.n}")

    @on_event(word)
    def mind(self, event: QosEvent) -> None:
        self.state.heard.append(f"{event.kind} {event.count_change}")


class Block(Message):
    values: RatioArray


class Collector(Node):
    block = Sub(Block)

    @on(block)
    def take(self, block: Block) -> None:
        """Take it."""


class Wired:
    """A reader's receiver, which the test feeds by hand."""

    def __init__(self, folder: Path, context: Any, qos: Qos, kind: type[Node] = Reader) -> None:
        self.clock, port = SimClock(), "word" if kind is Reader else "block"
        spec = NodeSpec(name="r", run="m:R", inputs={port: f"/p/{port}"}, qos={port: qos})
        self.executor = Executor(kind, spec, self.clock, lambda _: None)
        places = {f"/p/{port}": (f"ipc://{folder}/p", f"ipc://{folder}/s")}
        self.receiver = TopicReceiver(self.executor, places, context, None)
        self.executor.transition(Transition.CONFIGURE)
        self.executor.transition(Transition.ACTIVATE)
        self.receiver.set_start(0)

    def arrive(self, n: int, now_ns: int) -> None:
        self.clock.set(now_ns)
        frame = pack(b"/p/word", Kind.DATA, 0, n, now_ns, schema_of(Word).type_hash, encode(Word(n=n)))
        self.receiver._arrive(frame, now_ns)

    def work(self) -> list[str]:
        """Do what the loop does after it has taken in what has arrived."""
        self.executor.run_timers()
        while self.executor.inbox:
            self.receiver.deliver_next()
        return list(self.executor.node.state.heard)  # type: ignore[attr-defined]


@pytest.fixture
def context() -> Iterator[Any]:
    made: zmq.Context[Any] = zmq.Context()
    yield made
    made.destroy(linger=0)


def test_a_message_that_is_next_is_handled_as_it_arrives(tmp_path: Path, context: Any) -> None:
    wired = Wired(tmp_path, context, Qos())
    for n in (1, 2, 3):
        wired.arrive(n, n)
        wired.work() if n == 1 else None
    assert not wired.executor.inbox
    assert wired.work() == ["word 1", "word 2", "word 3"]
    wired.receiver.close()


def test_a_message_that_is_late_does_not_hide_that_its_deadline_was_missed(
    tmp_path: Path, context: Any
) -> None:
    wired = Wired(tmp_path, context, Qos(deadline_ms=DEADLINE_MS))
    wired.arrive(1, 0)
    wired.work()
    wired.arrive(2, WHILE_BUSY_NS)
    assert wired.work() == ["word 1", "deadline 3", "word 2"]
    wired.receiver.close()


def test_a_slow_best_effort_reader_skips_to_the_last_messages(tmp_path: Path, context: Any) -> None:
    wired = Wired(tmp_path, context, Qos(reliability="best_effort", depth=2))
    for n in range(1, 41):
        wired.arrive(n, n)
    assert wired.work() == ["word 39", "word 40"]
    account = wired.executor.ends.subscriptions["/p/word"][0].account
    assert (account.received, account.dropped, account.lost) == (2, 38, 0)
    wired.receiver.close()


def test_what_waits_for_a_slow_reader_of_arrays_is_bounded_in_bytes(tmp_path: Path, context: Any) -> None:
    wired = Wired(tmp_path, context, Qos(reliability="best_effort"), Collector)  # which waits its turn
    executor, receiver = wired.executor, wired.receiver
    assert receiver._subscriber._socket.getsockopt(zmq.RCVHWM) == ARRAY_QUEUE
    payload = encode(Block(values=np.zeros(640_000)))
    kind = schema_of(Block).type_hash
    publisher = context.socket(zmq.PUB)
    publisher.bind(f"ipc://{tmp_path}/p")
    sent = 0
    while len(executor.inbox) * len(payload) < MOST_UNREAD_BYTES:
        sent += 1
        publisher.send(pack(b"/p/block", Kind.DATA, 0, sent, 0, kind, payload))
        receiver.receive(1_000_000_000)
    unread = len(executor.inbox)
    receiver.receive(1_000_000_000)
    assert len(executor.inbox) == unread
    assert unread * len(payload) < MOST_UNREAD_BYTES + (ARRAY_QUEUE + 1) * len(payload)
    publisher.close(linger=0)
    receiver.close()


def test_what_a_slow_reader_of_arrays_loses_is_in_its_account(
    tmp_path: Path, context: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(publisher_socket, "QUEUE_BYTES", 8 << 20)
    monkeypatch.setattr(receiver_module, "ARRAY_QUEUE", 16)
    qos = Qos(reliability="best_effort", depth=1000)
    sockets = NodeSockets(f"ipc://{tmp_path}/p", f"ipc://{tmp_path}/s")
    wired = Wired(tmp_path, context, qos, Collector)
    executor, receiver = wired.executor, wired.receiver
    outlet = PublisherEnd("/p/block", Block, qos, 0, Owner(), sockets.publisher.send)
    sockets.publisher.offer([outlet])
    while not sockets.publisher.readers:
        sockets.poll()
    values = np.zeros(2 << 17)
    values.flags.writeable = False
    for _ in range(100):
        outlet.publish(Block(values=values))
    account = executor.ends.subscriptions["/p/block"][0].account
    while account.sequence < 100:
        sockets.publisher.send_heartbeats()
        receiver.receive(1_000_000_000)
        while executor.inbox:
            receiver.deliver_next()
    assert account.lost > 50
    assert account.received + account.lost == 100
    assert account.repeated == account.dropped == 0
    receiver.close()
    sockets.close()


def test_what_a_predecessor_rejected_it_has_heard(tmp_path: Path, context: Any) -> None:
    old, new = Wired(tmp_path, context, Qos()), Wired(tmp_path, context, Qos())
    old.arrive(1, 0)
    for n in (2, 3):
        old.receiver._arrive(pack(b"/p/word", Kind.DATA, 0, n, 0, schema_of(Word).type_hash, b"\xc1"), 0)
    for n in (4, 5):
        new.arrive(n, 0)
    old.work()
    handed = old.executor.full_snapshot()
    assert (handed.consumed["/p/word"].sequence, old.executor.events.rejected_count) == (1, 2)
    assert new.receiver.continue_from(handed, old.receiver.received) == 2
    assert new.work() == ["word 4", "word 5"]
    for wired in (old, new):
        wired.receiver.close()


def test_what_a_node_sends_does_not_hide_what_has_arrived(tmp_path: Path) -> None:
    """A node that has asked for something waits on descriptors; what it sends takes away their signal."""
    spec = NodeSpec(name="r", run=f"{__name__}:Reader", inputs={"word": "/p/word"})
    theirs, ours = socket.socketpair()
    folder = str(tmp_path)
    order = Spawn(spec=spec, clock="wall", run_dir=folder, workspace=folder, log=f"{folder}/log", place="r")
    loop = WallLoop(order, MessageChannel(ours, msgspec.msgpack.Decoder(ToNode)))
    receiver, context = loop.receiver, loop.sockets.context
    with context.socket(zmq.XPUB) as publisher, context.socket(zmq.ROUTER) as server:
        publisher.bind(f"ipc://{folder}/p.pub")
        server.bind(f"ipc://{folder}/p.srv")
        while publisher.recv() != b"\x01/p/word\0":
            pass
        receiver._requester.ask(f"ipc://{folder}/p.srv", {})
        asker, question = server.recv_multipart()
        server.send_multipart([asker, question])
        while not receiver._requester.replies():
            pass
        while select.select(receiver.file_descriptors, (), (), 0.0)[0]:
            loop._wait()
        publisher.send(pack(b"/p/word", Kind.DATA, 0, 1, 0, schema_of(Word).type_hash, encode(Word(n=1))))
        while not receiver._subscriber.wait(1.0):
            pass
        while select.select(receiver.file_descriptors, (), (), 0.1)[0]:
            receiver._subscriber.send_up(ACK)
            receiver._requester.pending()
        loop._wait()
        assert [frame.sequence for frame in loop.executor.inbox] == [1]
    loop.close()
    ours.close()
    theirs.close()
