"""Start the fork server's process, before anything else is imported: it warms up meanwhile."""

import os
import socket
import subprocess
import sys
from typing import NamedTuple

ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class ServerProcess(NamedTuple):
    """A fork server that has been started, and the launcher's end of its channel."""

    process: subprocess.Popen[bytes]
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
