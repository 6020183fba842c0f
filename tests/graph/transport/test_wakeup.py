"""A reader that waits inside its subscription is woken by messages and by anything else."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.frame import Kind, pack
from palp_core.graph.transport import subscriber_socket
from palp_core.graph.transport.subscriber_socket import UNTIL_RUNG, SubscriberSocket
from palp_core.graph.transport.wakeup import ENDPOINT, Wakeup

PATIENCE_MS = 60_000


class House:
    """A subscription with a wakeup at a pipe, and a publisher down the road."""

    def __init__(self, folder: Path) -> None:
        self.context: zmq.Context[Any] = zmq.Context()
        self.read, self.write = os.pipe()
        self.publisher = self.context.socket(zmq.XPUB)
        self.publisher.bind(f"ipc://{folder}/p")
        self.bell = Wakeup(self.context, [self.read])
        self.subscriber = SubscriberSocket({"/p/x": f"ipc://{folder}/p"}, self.context)
        self.subscriber.wake_on(ENDPOINT)
        self.publisher.recv()
        self.frames: list[bytes] = []

    def take(self, wait_ms: int = PATIENCE_MS) -> tuple[bool, bool]:
        return self.subscriber.dispatch(lambda raw, _: self.frames.append(raw), 0, wait_ms)

    def close(self) -> None:
        self.bell.close()
        self.subscriber.close()
        self.context.destroy(linger=0)
        os.close(self.read)
        os.close(self.write)


@pytest.fixture
def house(tmp_path: Path) -> Iterator[House]:
    made = House(tmp_path)
    yield made
    made.close()


def test_a_message_ends_the_waiting(house: House) -> None:
    frame = pack(b"/p/x", Kind.DATA, 0, 1, 0, 0, b"payload")
    house.publisher.send(frame)
    assert house.take() == (True, False)
    assert house.frames == [frame]


def test_the_bell_ends_the_waiting_and_rings_again_only_when_answered(house: House) -> None:
    os.write(house.write, b"!")
    assert house.take()[1]
    assert not house.take(1)[1]
    house.bell.rearm()
    assert house.take()[1]  # nobody has read the pipe: there is still something
    os.read(house.read, 1)
    house.bell.rearm()
    os.write(house.write, b"!")
    assert house.take()[1]
    assert house.frames == []


def test_nothing_ends_it_but_time(house: House) -> None:
    assert house.take(1) == (False, False)
    assert house.take(0) == (False, False)


def test_the_bell_keeps_the_time_until_it_is_told_not_to(house: House) -> None:
    due_ns = monotonic_ns() + 20_000_000
    house.bell.ring_at(due_ns)
    assert house.take(UNTIL_RUNG) == (False, True)
    assert monotonic_ns() >= due_ns
    house.bell.ring_at(monotonic_ns())
    house.bell.rearm()
    assert house.take(UNTIL_RUNG) == (False, True)
    house.bell.ring_at(None)
    house.bell.rearm()
    assert house.take(1) == (False, False)


def test_a_reader_at_leisure_waits_for_message_after_message_and_asks_the_socket_nothing(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: Any) -> bool:
        raise AssertionError("a question to the socket costs as much as a message")

    monkeypatch.setattr(subscriber_socket, "readable", refuse)
    monkeypatch.setattr(subscriber_socket, "BURST_NS", 0)
    frames = [pack(b"/p/x", Kind.DATA, 0, n, 0, 0, b"payload") for n in range(1, 4)]
    house.subscriber.at_leisure = lambda: len(house.frames) < 2
    for frame in frames:
        house.publisher.send(frame)
    took = house.subscriber.dispatch(lambda raw, _: house.frames.append(raw), 10**15, UNTIL_RUNG)
    assert took == (True, False)
    assert house.frames == frames[:2]
    assert house.subscriber.dispatch(lambda raw, _: house.frames.append(raw), 0, UNTIL_RUNG) == (False, False)
    assert house.frames == frames


def test_a_ring_ends_the_waiting_of_a_reader_at_leisure(house: House) -> None:
    house.subscriber.at_leisure = lambda: True
    house.publisher.send(pack(b"/p/x", Kind.DATA, 0, 1, 0, 0, b"payload"))
    os.write(house.write, b"!")
    rung = False
    while not rung:  # whichever comes first
        rung = house.subscriber.dispatch(lambda raw, _: house.frames.append(raw), 10**15, UNTIL_RUNG)[1]
        house.bell.rearm() if not house.frames else None
    assert len(house.frames) <= 1


def test_in_a_burst_a_reader_is_not_asked_for_each_message_whether_it_is_at_leisure(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("BURST_NS", "LOOK_NS"):
        monkeypatch.setattr(subscriber_socket, name, 10**18)
    monkeypatch.setattr(subscriber_socket, "monotonic_ns", lambda: 2 * 10**18)
    with house.context.socket(zmq.XPUB) as publisher:  # what it has sent is there at once
        publisher.bind("inproc://burst")
        house.subscriber.connect("inproc://burst")
        publisher.recv()
        frames = [pack(b"/p/x", Kind.DATA, 0, n, 0, 0, b"payload") for n in range(1, 51)]
        for frame in frames:
            publisher.send(frame)
        asked: list[int] = []

        def at_leisure() -> bool:
            asked.append(len(house.frames))
            return len(house.frames) < len(frames)

        house.subscriber.at_leisure = at_leisure
        took = house.subscriber.dispatch(lambda raw, _: house.frames.append(raw), 10**18, UNTIL_RUNG)
    assert took == (True, False)
    assert house.frames == frames
    assert asked == [1, 50]
