"""Sockets of the run directory are this user's alone, like everything in it."""

from pathlib import Path
from typing import Any

import zmq

from palp_core.whole_file import PRIVATE

_IPC = "ipc://"


def bind_private(socket: zmq.Socket[Any], endpoint: str) -> None:
    """Bind a socket that only this user can connect to: that takes the right to write to its file."""
    socket.bind(endpoint)
    if endpoint.startswith(_IPC):
        Path(endpoint.removeprefix(_IPC)).chmod(PRIVATE)
