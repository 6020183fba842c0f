"""Sockets of the run directory are this user's alone, like everything in it."""

from pathlib import Path
from typing import Any

import zmq

from palp_core.whole_file import PRIVATE

_IPC = "ipc://"


def bind_private(socket: zmq.Socket[Any], endpoint: str) -> None:
    """Bind a socket to which nobody else can connect: that takes the right to write to a Unix socket's file.

    Raises:
        zmq.ZMQError: It cannot be bound.
    """
    socket.bind(endpoint)
    if endpoint.startswith(_IPC):
        Path(endpoint.removeprefix(_IPC)).chmod(PRIVATE)
