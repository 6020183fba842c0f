"""Topics on real sockets: whole, greeted, unmixed, and unharmed by strangers."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
import zmq

from palp_core.graph.messages.frame import Kind, parse
from palp_core.graph.messages.message import Message, decode
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.transport import publisher_socket
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.graph.transport.publisher_socket import PLACE_BYTES, UNCOPIED_FROM_BYTES
from palp_core.graph.transport.request_server import NodeOperation, NodeRequest
from palp_core.graph.transport.requester_socket import ask
from palp_core.graph.transport.subscriber_socket import SubscriberSocket
from palp_core.units import RatioArray

PATIENCE_S = 60.0


class Block(Message):
    values: RatioArray


class Owner:
    publishing = True

    def now_ns(self) -> int:
        return 7

    def resend(self, frame: bytes) -> None:
        raise AssertionError("nothing is sent again here")


class Publisher:
    """A sending process in this one."""

    def __init__(self, folder: Path) -> None:
        self.endpoint, self.serve = f"ipc://{folder}/p", f"ipc://{folder}/s"
        self.sockets = NodeSockets(self.endpoint, self.serve)
        self.subscribers: list[SubscriberSocket] = []

    def outlet(self, topic: str, epoch: int = 0) -> PublisherEnd[Block]:
        outlet = PublisherEnd(topic, Block, Qos(), epoch, Owner(), self.sockets.publisher.send)
        self.sockets.publisher.offer([outlet])
        return outlet

    def reader(self, *topics: str) -> SubscriberSocket:
        subscriber = SubscriberSocket(dict.fromkeys(topics, self.endpoint))
        self.subscribers.append(subscriber)
        return subscriber

    def receive(self, subscriber: SubscriberSocket, enough: Callable[[list[bytes]], bool]) -> list[bytes]:
        """Serve the sockets and wait on socket events until the reader has enough."""
        frames: list[bytes] = []
        poller = zmq.Poller()
        for descriptor in (*self.sockets.file_descriptors, subscriber.file_descriptor):
            poller.register(descriptor, zmq.POLLIN)
        while not enough(frames):
            self.sockets.poll()
            frames += subscriber.receive()
            if enough(frames):
                break
            if not (self.sockets.pending() or subscriber.pending()):
                assert poller.poll(round(PATIENCE_S * 1e3)), f"nothing more came after {frames}"
        return frames

    def match(self, subscriber: SubscriberSocket, topics: int = 1) -> list[bytes]:
        return self.receive(subscriber, lambda frames: len(frames) >= topics)

    def serve_until(self, descriptor: Any) -> None:
        """Serve the sockets until another socket has something to read."""
        poller = zmq.Poller()
        poller.register(descriptor, zmq.POLLIN)
        for own in self.sockets.file_descriptors:
            poller.register(own, zmq.POLLIN)
        while True:
            self.sockets.poll()
            if self.sockets.pending():
                continue
            ready = dict(poller.poll(round(PATIENCE_S * 1e3)))
            assert ready, "nobody answered"
            if descriptor in ready:
                return


@pytest.fixture
def publisher(tmp_path: Path) -> Iterator[Publisher]:
    made = Publisher(tmp_path)
    yield made
    for subscriber in made.subscribers:
        subscriber.close()
    made.sockets.close()


def data_of(frames: list[bytes]) -> list[bytes]:
    return [frame for frame in frames if parse(frame).kind == Kind.DATA]


def block(size: int = 1, value: float = 1.0) -> Block:
    return Block(values=np.full(size, value))


def test_every_reader_is_greeted_by_a_heartbeat_with_the_last_sequence(publisher: Publisher) -> None:
    outlet = publisher.outlet("/a/b", epoch=3)
    for sequence in (1, 2):
        outlet.publish(block())
        (greeting,) = publisher.match(publisher.reader("/a/b"))
        assert parse(greeting)[:4] == ("/a/b", Kind.HEARTBEAT, 3, sequence)


def test_a_beat_says_nothing_of_a_topic_that_spoke_itself_and_something_as_soon_as_it_is_quiet(
    publisher: Publisher,
) -> None:
    outlet, other = publisher.outlet("/a/b"), publisher.outlet("/a/c")
    reader = publisher.reader("/a/b", "/a/c")
    publisher.match(reader, topics=2)
    beats = publisher.sockets.publisher.send_heartbeats

    def said(count: int) -> list[tuple[str, int, int]]:
        frames = [parse(frame) for frame in publisher.receive(reader, lambda frames: len(frames) >= count)]
        return [(frame.topic, frame.kind, frame.sequence) for frame in frames]

    outlet.publish(block())
    beats(to_all=False)
    assert said(2) == [("/a/b", Kind.DATA, 1), ("/a/c", Kind.HEARTBEAT, 0)]
    beats(to_all=False)
    assert sorted(said(2)) == [("/a/b", Kind.HEARTBEAT, 1), ("/a/c", Kind.HEARTBEAT, 0)]
    other.publish(block())
    beats()
    assert sorted(said(3)) == [
        ("/a/b", Kind.HEARTBEAT, 1), ("/a/c", Kind.DATA, 1), ("/a/c", Kind.HEARTBEAT, 1),
    ]  # fmt: skip


def test_a_topic_that_moves_says_so_at_each_beat_though_it_speaks(publisher: Publisher) -> None:
    outlet = publisher.outlet("/a/b")
    reader = publisher.reader("/a/b")
    publisher.match(reader)
    publisher.sockets.publisher.announcement = b"elsewhere"
    outlet.publish(block())
    publisher.sockets.publisher.send_heartbeats(to_all=False)
    frames = publisher.receive(reader, lambda frames: len(frames) >= 3)
    assert [parse(frame).kind for frame in frames] == [Kind.DATA, Kind.HEARTBEAT, Kind.MOVED]


def test_a_topic_whose_name_begins_another_is_not_mixed_with_it(publisher: Publisher) -> None:
    short, long = publisher.outlet("/a/b"), publisher.outlet("/a/bc")
    of_short, of_long = publisher.reader("/a/b"), publisher.reader("/a/bc")
    publisher.match(of_short)
    publisher.match(of_long)
    for _ in range(3):
        long.publish(block())
        short.publish(block())
    for reader, topic in ((of_short, "/a/b"), (of_long, "/a/bc")):
        frames = publisher.receive(
            reader, lambda frames: parse(frames[-1]).sequence == 3 if frames else False
        )
        assert {parse(frame).topic for frame in frames} == {topic}


@pytest.mark.parametrize("size", [1, UNCOPIED_FROM_BYTES // 8 - 20, UNCOPIED_FROM_BYTES // 8, 200_000])
def test_messages_of_any_size_arrive_whole_and_equal(publisher: Publisher, size: int) -> None:
    outlet = publisher.outlet("/a/b")
    reader = publisher.reader("/a/b")
    publisher.match(reader)
    rng = np.random.default_rng(size)
    sent = [Block(values=rng.normal(size=size)) for _ in range(3)]
    for message in sent:
        outlet.publish(message)
    frames = publisher.receive(reader, lambda frames: len(data_of(frames)) >= 3)
    assert data_of(frames) == list(outlet.history)
    assert [decode(Block, parse(frame).payload) for frame in data_of(frames)] == sent


def test_a_large_message_takes_a_place_per_mib_and_what_fills_them_says_nothing_new(
    publisher: Publisher,
) -> None:
    outlet = publisher.outlet("/a/b")
    reader = publisher.reader("/a/b")
    publisher.match(reader)
    outlet.publish(block(5 * (PLACE_BYTES // 8)))
    outlet.publish(block(PLACE_BYTES // 8 - 20))
    frames = [parse(frame) for frame in publisher.receive(reader, lambda frames: len(frames) >= 7)]
    assert [(frame.kind, frame.sequence) for frame in frames] == [
        (Kind.DATA, 1),
        *[(Kind.HEARTBEAT, 1)] * 5,
        (Kind.DATA, 2),
    ]


def test_a_reader_that_does_not_read_holds_as_many_mib_as_it_has_places(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(publisher_socket, "QUEUE_BYTES", 16 * PLACE_BYTES)
    publisher = Publisher(tmp_path)
    reader = SubscriberSocket({"/a/b": publisher.endpoint}, queue=16)
    publisher.subscribers.append(reader)
    outlet = publisher.outlet("/a/b")
    publisher.match(reader)
    large = block(4 * (PLACE_BYTES // 8))
    in_flight = publisher.sockets.publisher._in_flight
    for _ in range(40):
        before = len(in_flight._parts)
        outlet.publish(large)
        assert in_flight._total <= 16 * PLACE_BYTES
        for _ in range(10_000):  # lets the threads of the sockets move on as far as they can
            if len(in_flight._parts) <= before and in_flight.has_room(large.values.nbytes):
                break
    outlet.publish(block())
    publisher.sockets.publisher.send_heartbeats()
    frames = publisher.receive(reader, lambda frames: parse(frames[-1]).sequence == 41 if frames else False)
    sizes = [len(frame) for frame in data_of(frames) if len(frame) > PLACE_BYTES]
    assert (
        4 <= len(sizes) <= 4 + 1 + 4 + 1
    )  # the reader's places, half a one, the publisher's bytes, the kernel's
    publisher.sockets.close()
    reader.close()


def test_a_topic_that_nobody_reads_costs_no_send_but_keeps_counting(publisher: Publisher) -> None:
    outlet = publisher.outlet("/a/b")
    assert not publisher.sockets.publisher.has_subscribers
    outlet.publish(block())
    reader = publisher.reader("/a/b")
    publisher.match(reader)
    assert publisher.sockets.publisher.has_subscribers
    outlet.publish(block())
    (frame,) = publisher.receive(reader, bool)
    assert parse(frame).sequence == 2


@pytest.mark.parametrize(
    "events",
    [
        [b"\x02/a/b\0"],
        [b"hello"],
        [b""],
        [b"\x01/a/b", b"\0/a/b"],
        [b"\x01/a/b\0\0", b"\0/a/b\0\0"],
        [b"\x01", b"\0"],
    ],
)
def test_a_stranger_upstream_cannot_silence_a_topic(publisher: Publisher, events: list[bytes]) -> None:
    outlet = publisher.outlet("/a/b")
    reader = publisher.reader("/a/b")
    publisher.match(reader)
    with zmq.Context() as context, context.socket(zmq.XSUB) as stranger:
        stranger.setsockopt(zmq.LINGER, 1000)
        stranger.connect(publisher.endpoint)
        for event in events:
            stranger.send(event)
        stranger.send(b"\x01/a/b\0")
        publisher.serve_until(stranger)
        outlet.publish(block())
        frames = publisher.receive(reader, lambda frames: any(parse(f).kind == Kind.DATA for f in frames))
        assert parse(frames[-1]).sequence == 1


def test_a_plain_request_socket_gets_an_answer_or_an_error(publisher: Publisher) -> None:
    class Double(NodeRequest, frozen=True, kw_only=True):
        value: int

    def fails(request: NodeRequest) -> dict[str, Any]:
        raise RuntimeError("\udcff")

    answers = {"fails": fails, "huge": lambda _: {"lost": 2**70}, "strange": lambda _: {"it": object()}}
    operations = {name: NodeOperation(NodeRequest, answer) for name, answer in answers.items()}
    double = NodeOperation(Double, lambda request: {"value": 2 * request.value})
    publisher.sockets.requests.add("n", {"double": double, **operations})
    with zmq.Context() as context, context.socket(zmq.REQ) as stranger:
        stranger.connect(publisher.serve)
        for op in ("double", *answers):
            stranger.send(msgpack.packb({"op": op, "value": 21}))
            publisher.serve_until(stranger)
            reply = msgpack.unpackb(stranger.recv())
            assert reply == {"value": 42} if op == "double" else reply["error"]


def test_asking_nobody_returns_none(tmp_path: Path) -> None:
    assert ask(f"ipc://{tmp_path}/nobody", {"op": "info"}, 0.01) is None
