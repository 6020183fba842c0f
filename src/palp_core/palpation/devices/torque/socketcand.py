"""A CAN bus behind a socketcand server that may be gone, mute, or something else."""

import socket
from collections.abc import Mapping
from typing import Any

from can.interfaces.socketcand import SocketCanDaemonBus

_GREETING_S = 1.0
_LONGEST = 64


class PatientBus(SocketCanDaemonBus):
    """python-can's bus, which would wait for ever for a server that says nothing or takes nothing.

    It would also take one read for one answer, and refuse a bus on which others speak: their frames follow
    the last answer at once.
    """

    def _expect_msg(self, msg: str) -> None:
        connection: socket.socket = getattr(self, "_SocketCanDaemonBus__socket")  # noqa: B009 - private there
        connection.settimeout(_GREETING_S)
        try:
            _expect(connection, msg.encode("ascii"))
        except BaseException:
            connection.close()
            raise


def open_socketcand(options: Mapping[str, Any]) -> PatientBus:
    """Open the bus of a server.

    Args:
        options: ``host``, ``port``, ``channel``, and what else python-can takes.

    Raises:
        KeyError: One of the three is missing.
        OSError: Nobody is there or nothing is said.
        ValueError: It is no socketcand.
        can.CanError: It was, a moment ago.
    """
    _greet(options["host"], int(options["port"]), options["channel"])
    rest = {name: value for name, value in options.items() if name != "interface"}
    return PatientBus(**{**rest, "port": int(options["port"])})  # type: ignore[no-untyped-call]


def _greet(host: str, port: int, channel: str) -> None:
    """See whether a server is there and speaks: python-can would try for ten seconds without a pause."""
    with socket.create_connection((host, port), timeout=_GREETING_S) as connection:
        for sent, expected in (("", b"< hi >"), (f"< open {channel} >", b"< ok >")):
            connection.sendall(sent.encode("ascii"))
            _expect(connection, expected)


def _expect(connection: socket.socket, expected: bytes) -> None:
    """Read one answer, however it is cut, and nothing that follows it.

    Raises:
        OSError: Nothing is said.
        ValueError: Something else is.
    """
    answer = b""
    while not answer.endswith(b">") and len(answer) < _LONGEST:
        if not (byte := connection.recv(1)):
            break
        answer += byte
    if answer != expected:
        raise ValueError(f"the server said {answer[:20]!r}, not {expected!r}")
