"""A socketcand server that falls silent is an error in time, not a wait for ever."""

from __future__ import annotations

import socket
import threading

import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.devices.torque import socketcand
from palp_core.palpation.devices.torque.ati_session import _open_bus


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


@pytest.mark.parametrize("said", [[], [b"< hi >"], [b"< hi >", b"< ok >"], [b"< hello >"]])
def test_a_server_that_falls_silent_after_its_greeting_is_an_error_in_time(
    monkeypatch: pytest.MonkeyPatch, said: list[bytes]
) -> None:
    monkeypatch.setattr(socketcand, "_GREETING_S", 2.0)
    over = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:
        answers = [[b"< hi >", b"< ok >"], said]
        thread = threading.Thread(target=serve, args=(server, answers, over), daemon=True)
        thread.start()
        options = {"interface": "socketcand", "channel": "can0", "host": "127.0.0.1"}
        try:
            with pytest.raises(DeviceError, match="cannot open the bus"):
                _open_bus({**options, "port": server.getsockname()[1]})
        finally:
            over.set()
            thread.join()


def test_an_option_that_is_missing_is_named() -> None:
    with pytest.raises(DeviceError, match="no option 'host'"):
        _open_bus({"interface": "socketcand", "channel": "can0"})


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
        bus = _open_bus({**options, "port": server.getsockname()[1]})
        try:
            message = bus.recv(60.0)
            assert message.arbitration_id == 0x321
        finally:
            bus.shutdown()
            over.set()
            thread.join()
