"""A socketcand server that falls silent is an error in time, not a wait for ever."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator

import can
import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.devices.torque.ati_session import open_bus


def serve(server: socket.socket, answers: list[list[bytes]], over: threading.Event) -> None:
    """Answer each connection in turn with its lines, then say nothing until it is over."""
    held = []
    for lines in answers:
        connection, _ = server.accept()
        held.append(connection)
        for line in lines:
            connection.sendall(line)
            if line is not lines[-1]:
                connection.recv(256)
    over.wait(60.0)
    for connection in held:
        connection.close()


@contextlib.contextmanager
def greeted(server: socket.socket) -> Iterator[socket.socket]:
    """Greet who looks whether it is a socketcand, then who stays; that one waits for its last "< ok >"."""
    for stays in (False, True):
        connection, _ = server.accept()
        with connection:
            connection.sendall(b"< hi >")
            connection.recv(256)
            connection.sendall(b"< ok >")
            if stays:
                connection.recv(256)
                yield connection


@pytest.mark.parametrize("said", [[], [b"< hi >"], [b"< hi >", b"< ok >"], [b"< hello >"]])
def test_a_server_that_falls_silent_after_its_greeting_is_an_error_in_time(
    said: list[bytes],
) -> None:
    over = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:
        answers = [[b"< hi >", b"< ok >"], said]
        thread = threading.Thread(target=serve, args=(server, answers, over), daemon=True)
        thread.start()
        options = {"interface": "socketcand", "channel": "can0", "host": "127.0.0.1"}
        try:
            with pytest.raises(DeviceError, match="cannot open the bus"):
                open_bus({**options, "port": server.getsockname()[1]}, greeting_s=0.3)
        finally:
            over.set()
            thread.join()


def test_an_option_that_is_missing_is_named() -> None:
    with pytest.raises(DeviceError, match="no option 'host'"):
        open_bus({"interface": "socketcand", "channel": "can0"})


def test_answers_that_come_in_pieces_and_frames_of_others_right_behind_them_are_no_refusal() -> None:
    frame, over = b"< frame 321 1.5 0102 >", threading.Event()
    cut = [b"< ", b"hi >", b"< o", b"k >"]

    def talk(connection: socket.socket, ends: bytes) -> None:
        for k, piece in enumerate(cut):
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.sendall(piece)
            if k == 1:
                connection.recv(256)
        connection.sendall(ends)

    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve_all() -> None:
            first, _ = server.accept()
            with first:
                talk(first, b"")
                second, _ = server.accept()
                with second:
                    talk(second, b"< ok >" + frame)
                    over.wait(60.0)

        thread = threading.Thread(target=serve_all, daemon=True)
        thread.start()
        options = {"interface": "socketcand", "channel": "can0", "host": "127.0.0.1"}
        bus = open_bus({**options, "port": server.getsockname()[1]})
        try:
            message = bus.recv(60.0)
            assert message.arbitration_id == 0x321
        finally:
            bus.shutdown()
            over.set()
            thread.join()


def test_frames_come_whole_however_they_are_cut_and_the_end_of_a_connection_is_an_error_at_once() -> None:
    pieces = [b"< frame 321 1.5 0102 >< frame 3", b"22 1.5 03 >< frame 123 1.5 04 >"]
    cut, sent = threading.Event(), b""

    def serve_all() -> None:
        nonlocal sent
        with greeted(server) as connection:
            connection.sendall(b"< ok >" + pieces[0])
            cut.wait(60.0)
            connection.sendall(pieces[1])
            sent = connection.recv(256)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve_all, daemon=True)
        thread.start()
        options = {"interface": "socketcand", "channel": "can0", "host": "127.0.0.1", "tcp_tune": True}
        filters = [{"can_id": 0x320, "can_mask": 0x7F0, "extended": False}]
        bus = open_bus({**options, "port": server.getsockname()[1], "can_filters": filters})
        try:
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
            assert sent == b"< send 200 1 5 >"
        finally:
            bus.shutdown()
            cut.set()
            thread.join()


def test_what_is_no_socketcand_is_an_error_and_not_a_frame() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve_all() -> None:
            with greeted(server) as connection:
                connection.sendall(b"< ok >\xff\xfe>")

        thread = threading.Thread(target=serve_all, daemon=True)
        thread.start()
        options = {"interface": "socketcand", "channel": "can0", "host": "127.0.0.1"}
        bus = open_bus({**options, "port": server.getsockname()[1]})
        try:
            with pytest.raises(can.CanError, match="no socketcand"):
                bus.recv(60.0)
        finally:
            bus.shutdown()
            thread.join()


def test_a_flood_of_frames_of_others_keeps_nobody_longer_than_asked() -> None:
    over = threading.Event()

    def serve_all() -> None:
        with greeted(server) as connection, contextlib.suppress(OSError):  # the bus has been shut down
            connection.sendall(b"< ok >")
            while not over.is_set():
                connection.sendall(b"< frame 123 1.5 04 >" * 1000)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve_all, daemon=True)
        thread.start()
        options = {"interface": "socketcand", "channel": "can0", "host": "127.0.0.1"}
        filters = [{"can_id": 0x320, "can_mask": 0x7F0, "extended": False}]
        bus = open_bus({**options, "port": server.getsockname()[1], "can_filters": filters})
        try:
            assert bus.recv(0.0) is None
            assert bus.recv(0.01) is None
        finally:
            over.set()
            bus.shutdown()
            thread.join(60.0)
