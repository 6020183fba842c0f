"""Another process that holds a device's link, to stop the device should its commander be killed."""

import socket
import subprocess
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from palp_core.errors import DeviceError
from palp_core.palpation.devices.link import guard_process

_START_S = 30.0
_END_S = 1.0

LastWords = Iterable[tuple[float, bytes]]
"""What to write to the device, and how many seconds after the owner's death."""


class LinkGuard:
    """A process of its own, which holds the same link and speaks when this process is gone.

    The kernel closes the channel between the two when this one dies, however that comes: nothing is polled,
    and nothing else must live. The guard is in no group of processes that is killed with this one, and has
    its scheduling. As the link is the same, a device that can be reached only once is guarded as well.
    """

    def __init__(self, name: str, descriptor: int, last_words: LastWords) -> None:
        self._name = name
        self._channel, theirs = socket.socketpair()
        words = [f"{after_s * 1e3:g}:{word.hex()}" for after_s, word in last_words]
        with theirs:
            self._process = subprocess.Popen(
                [
                    sys.executable,
                    "-I",
                    "-S",
                    guard_process.__file__,
                    f"{theirs.fileno()}",
                    f"{descriptor}",
                    *words,
                ],
                pass_fds=(theirs.fileno(), descriptor),
                cwd=Path("/"),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
            )
        self._channel.settimeout(_START_S)
        try:
            started = self._channel.recv(1) == guard_process.READY
        except OSError:
            started = False
        if not started:
            self.release()
            raise DeviceError(
                f"{name}: the guard of its link did not start, so no motion is permitted; "
                "check permissions and memory"
            )
        self._channel.setblocking(False)

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether it is there."""
        try:
            return self._channel.recv(1) != b""
        except BlockingIOError:
            return True
        except OSError:
            return False

    def release(self) -> None:
        """Let it end without a word; returns when it has let go of the link."""
        with suppress(OSError):
            self._channel.sendall(b"q")
        self._channel.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:  # stopped, perhaps
            self._process.kill()
            self._process.wait()
