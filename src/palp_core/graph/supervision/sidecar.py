"""A process that works for this one, starts with it and never outlives it: a gateway, a bridge."""

import os
import select
import socket
import subprocess
import sys
from pathlib import Path
from typing import Generic, TypeVar

import msgspec

from palp_core.graph.process.channel import ChannelMessage, MessageChannel
from palp_core.whole_file import open_private

CLOSE_TIMEOUT_S = 2.0
Received = TypeVar("Received")


class Sidecar(Generic[Received]):
    """One process and the channel to it.

    It must end when the channel closes; if this process is killed, the kernel kills it.
    """

    def __init__(self, module: str, decoder: msgspec.msgpack.Decoder[Received], log: Path) -> None:
        ours, theirs = socket.socketpair()
        with theirs, open(log, "ab", opener=open_private) as output:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", module, str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                env={**os.environ, "PYTHONUNBUFFERED": "1"},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )
        self._channel = MessageChannel(ours, decoder)

    @property
    def descriptor(self) -> int:
        """Becomes readable when it has sent something."""
        return self._channel.socket.fileno()

    @property
    def pid(self) -> int:
        return self._process.pid

    def send(self, message: ChannelMessage) -> None:
        self._channel.send(message)

    def receive(self) -> list[Received]:
        """Return the messages that it has sent; wait if there is none."""
        return self._channel.receive_all()

    def wait(self, timeout_s: float) -> bool:
        """Wait until it has sent something or is gone; return False on time-out."""
        return bool(select.select((self._channel.socket,), (), (), max(timeout_s, 0.0))[0])

    def close(self) -> int:
        """End it; return its exit status."""
        self._channel.close()
        try:
            return self._process.wait(CLOSE_TIMEOUT_S)
        except subprocess.TimeoutExpired:  # stopped, perhaps
            self._process.kill()
            return self._process.wait()
