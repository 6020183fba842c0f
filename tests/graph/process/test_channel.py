"""The private line: messages arrive whole, however the socket cuts them."""

import socket
from collections.abc import Iterator

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.graph.process.channel import ChannelClosed, MessageChannel
from palp_core.graph.process.control_messages import (
    Activate,
    Configured,
    Done,
    Failed,
    FromNode,
    Hello,
    Matched,
    Relay,
    Round,
    Shutdown,
    ToNode,
)

frames = st.lists(st.binary(max_size=50), max_size=3)
from_node = st.one_of(
    st.builds(Hello, st.text(max_size=5), st.integers(0, 2**31)),
    st.builds(Configured),
    st.builds(Matched),
    st.builds(Done, frames, st.integers(-1, 2**62), st.none() | st.integers(0, 255)),
    st.builds(Failed, st.text(max_size=20)),
    st.builds(Relay, st.binary(max_size=20), st.none() | st.integers(0, 255)),
)
to_node = st.one_of(
    st.builds(Activate, st.integers(0, 2**62)),
    st.builds(Round, st.integers(0, 2**62), frames),
    st.builds(Shutdown, st.integers(0, 2**62)),
)

Pair = tuple[MessageChannel[FromNode], MessageChannel[ToNode]]


@pytest.fixture
def pair() -> Iterator[Pair]:
    ours, theirs = socket.socketpair()
    supervisor = MessageChannel[FromNode](ours, msgspec.msgpack.Decoder(FromNode))
    node = MessageChannel[ToNode](theirs, msgspec.msgpack.Decoder(ToNode))
    yield supervisor, node
    supervisor.close()
    node.close()


@settings(max_examples=50)
@given(st.lists(from_node, max_size=8), st.lists(to_node, max_size=8))
def test_both_ways_messages_arrive_equal_and_in_order(up: list[FromNode], down: list[ToNode]) -> None:
    ours, theirs = socket.socketpair()
    supervisor = MessageChannel[FromNode](ours, msgspec.msgpack.Decoder(FromNode))
    node = MessageChannel[ToNode](theirs, msgspec.msgpack.Decoder(ToNode))
    for message in up:
        node.send(message)
    for command in down:
        supervisor.send(command)
    assert [supervisor.receive() for _ in up] == up
    assert [node.receive() for _ in down] == down
    assert not supervisor.buffered()
    supervisor.close()
    node.close()


@settings(max_examples=50)
@given(st.lists(st.integers(1, 12), min_size=1, max_size=30))
def test_a_message_cut_into_pieces_is_put_together(cuts: list[int]) -> None:
    ours, theirs = socket.socketpair()
    payload = msgspec.msgpack.encode(Round(7, [b"abc", b"d" * 40]))
    stream = (len(payload).to_bytes(4, "little") + payload) * 2
    link = MessageChannel[ToNode](ours, msgspec.msgpack.Decoder(ToNode))
    start = 0
    for cut in cuts:
        theirs.sendall(stream[start : start + cut])
        start += cut
    theirs.sendall(stream[start:])
    theirs.close()
    assert [link.receive(), link.receive()] == [Round(7, [b"abc", b"d" * 40])] * 2
    with pytest.raises(ChannelClosed):
        link.receive()
    link.close()


def test_messages_that_came_together_are_told_without_touching_the_socket(pair: Pair) -> None:
    supervisor, node = pair
    node.send(Configured())
    node.send(Matched())
    assert not supervisor.buffered()
    assert supervisor.receive() == Configured()
    assert supervisor.buffered()
    assert supervisor.receive() == Matched()
    assert not supervisor.buffered()


def test_half_a_message_before_the_end_is_an_end(pair: Pair) -> None:
    supervisor, node = pair
    node.socket.sendall(b"\x10\0\0\0half")
    node.close()
    with pytest.raises(ChannelClosed, match="end of stream"):
        supervisor.receive()


def test_talking_to_nobody_says_so(pair: Pair) -> None:
    supervisor, node = pair
    node.close()
    with pytest.raises(ChannelClosed):
        supervisor.send(Shutdown(0))
    with pytest.raises(ChannelClosed):
        supervisor.receive()


def test_a_hung_up_end_can_still_say_its_last_words(pair: Pair) -> None:
    supervisor, node = pair
    node.socket.shutdown(socket.SHUT_RD)
    with pytest.raises(ChannelClosed):
        node.receive()
    node.send(Failed("why"))
    assert supervisor.receive() == Failed("why")
