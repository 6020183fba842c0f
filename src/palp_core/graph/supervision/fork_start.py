"""Start the fork server's process, before anything else is imported: it warms up meanwhile."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from typing import NamedTuple

ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class Fork:
    """A fork of this process, with what a fork server's :class:`~subprocess.Popen` is used for."""

    def __init__(self, work: Callable[[], None]) -> None:
        self.pid = os.fork()
        if self.pid == 0:
            try:
                os.setsid()
                work()
            finally:
                os._exit(0)

    def send_signal(self, number: int) -> None:
        os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def wait(self, _timeout_s: float | None = None) -> int:
        return os.waitpid(self.pid, 0)[1]


class ServerProcess(NamedTuple):
    """A fork server that has been started, and the launcher's end of its channel."""

    process: subprocess.Popen[bytes] | Fork
    channel: socket.socket


def start_fork_server() -> ServerProcess:
    """Start a fork server: one BLAS thread, a fixed hash seed, a session of its own."""
    ours, theirs = socket.socketpair()
    environment = {**os.environ, **ONE_THREAD, "PYTHONHASHSEED": "0", "PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "palp_core.graph.supervision.fork_server", str(theirs.fileno())],
        pass_fds=[theirs.fileno()],
        env=environment,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
    )
    theirs.close()
    return ServerProcess(process, ours)
