"""A socketcand server that falls silent is an error in time, not a wait for ever."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import can
import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.devices.torque.ati_session import open_bus

OPTIONS = {"interface": "socketcand", "channel": "can0", "host": "127.0.0.1", "tcp_tune": True}
OURS = [{"can_id": 0x320, "can_mask": 0x7F0, "extended": False}]
Talk = Callable[[socket.socket], None]


@contextlib.contextmanager
def serving(*talks: Talk) -> Iterator[dict[str, Any]]:
    """Serve each connection in turn by one of the talks; yield the options that lead there."""

    def serve() -> None:
        with contextlib.ExitStack() as held, contextlib.suppress(OSError):  # the bus has been shut down
            for talk in talks:
                connection = held.enter_context(server.accept()[0])
                talk(connection)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield {**OPTIONS, "port": server.getsockname()[1]}
    thread.join(60.0)


@contextlib.contextmanager
def opened(**options: Any) -> Iterator[Any]:
    bus = open_bus(options)
    try:
        yield bus
    finally:
        bus.shutdown()


def say(*lines: bytes) -> Talk:
    """Return what says each line, and waits for an answer between two."""

    def talk(connection: socket.socket) -> None:
        for number, line in enumerate(lines):
            if number:
                connection.recv(256)
            connection.sendall(line)

    return talk


GREET = say(b"< hi >", b"< ok >")


def then(talk: Talk) -> Talk:
    """Return what greets who stays, and then talks."""

    def whole(connection: socket.socket) -> None:
        GREET(connection)
        connection.recv(256)
        talk(connection)

    return whole


@pytest.mark.parametrize("shown", [[], [b"< hi >"], [b"< hi >", b"< ok >"], [b"< hello >"]])
def test_a_server_that_falls_silent_after_its_greeting_is_an_error_in_time(shown: list[bytes]) -> None:
    over = threading.Event()

    def falls_silent(connection: socket.socket) -> None:
        say(*shown)(connection)
        over.wait(60.0)

    with serving(GREET, falls_silent) as options:
        with pytest.raises(DeviceError, match="cannot open the bus"):
            open_bus(options, greeting_s=0.3)
        over.set()


def test_an_option_that_is_missing_is_named() -> None:
    with pytest.raises(DeviceError, match="no option 'host'"):
        open_bus({"interface": "socketcand", "channel": "can0"})


def test_answers_that_come_in_pieces_and_frames_of_others_right_behind_them_are_no_refusal() -> None:
    def in_pieces(ends: bytes) -> Talk:
        def talk(connection: socket.socket) -> None:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.sendall(b"< ")
            connection.sendall(b"hi >")
            connection.recv(256)
            connection.sendall(b"< o")
            connection.sendall(b"k >" + ends)
            while connection.recv(256):  # until the client has closed
                pass

        return talk

    talks = in_pieces(b""), in_pieces(b"< ok >< frame 321 1.5 0102 >")
    with serving(*talks) as options, opened(**options) as bus:
        assert bus.recv(60.0).arbitration_id == 0x321


def test_frames_come_whole_however_they_are_cut_and_the_end_of_a_connection_is_an_error_at_once() -> None:
    cut, sent = threading.Event(), list[bytes]()

    def talk(connection: socket.socket) -> None:
        connection.sendall(b"< ok >< frame 321 1.5 0102 >< frame 3")
        cut.wait(60.0)
        connection.sendall(b"22 1.5 03 >< frame 123 1.5 04 >")
        sent.append(connection.recv(256))

    with serving(GREET, then(talk)) as options, opened(**options, can_filters=OURS) as bus:
        first = bus.recv(60.0)
        assert (first.arbitration_id, bytes(first.data)) == (0x321, b"\1\2")
        assert bus.recv(0.0) is None
        assert bus.recv(0.001) is None
        cut.set()
        second = bus.recv(60.0)
        assert (second.arbitration_id, bytes(second.data)) == (0x322, b"\3")
        assert bus.recv(0.0) is None
        bus.send(can.Message(arbitration_id=0x200, is_extended_id=False, data=b"\5"))
        with pytest.raises(can.CanError, match="closed"):
            bus.recv(60.0)
        assert sent == [b"< send 200 1 5 >"]


def test_what_is_no_socketcand_is_an_error_and_not_a_frame() -> None:
    strange, refused = then(say(b"< ok >\xff\xfe>")), pytest.raises(can.CanError, match="no socketcand")
    with serving(GREET, strange) as options, opened(**options) as bus, refused:
        bus.recv(60.0)


def test_a_flood_of_frames_of_others_makes_no_wait_longer_than_asked() -> None:
    def flood(connection: socket.socket) -> None:
        connection.sendall(b"< ok >")
        while True:  # until the bus has been shut down
            connection.sendall(b"< frame 123 1.5 04 >" * 1000)

    with serving(GREET, then(flood)) as options, opened(**options, can_filters=OURS) as bus:
        assert bus.recv(0.0) is None
        assert bus.recv(0.01) is None
