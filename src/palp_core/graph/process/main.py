"""The main function of a node's process: connect, configure, then follow the conductor or the wall clock."""

from __future__ import annotations

import contextlib
import gc
import logging
import os
import signal
import socket
import sys

from palp_core.errors import NodeError, PalpError, in_words
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.node.loading import NodeProcess
from palp_core.graph.process.channel import Failed, Hello, LinkClosed, node_end
from palp_core.graph.process.lockstep_loop import LockstepMain
from palp_core.graph.process.wall_loop import WallMain


def run_node(birth: NodeProcess) -> int:
    """Run one node until the supervisor ends it, and return the exit status of its process."""
    logging.basicConfig(
        level=logging.INFO,
        format=f"[%(levelname)s] [{birth.spec.name}]: %(message)s",
        stream=sys.stderr,
        force=True,
    )
    link = node_end(f"{birth.run_dir}/supervisor.sock")
    link.send(Hello(birth.place, os.getpid()))
    for number in (signal.SIGINT, signal.SIGTERM):  # the loop sees the end of the line, at a handler boundary
        signal.signal(number, lambda *_: link.socket.shutdown(socket.SHUT_RD))
    process: LockstepMain | WallMain | None = None
    try:
        process = LockstepMain(birth, link) if birth.clock == "sim" else WallMain(birth, link)
        gc.collect()
        gc.freeze()
        process.run()
    except LinkClosed:
        _safe_end(process)
        return 1
    except (Exception, SystemExit, KeyboardInterrupt) as error:
        text = in_words(error)
        trace = None if isinstance(error, NodeError) else error  # a NodeError's trace is in the log already
        logging.getLogger("palp").error("%s", text, exc_info=trace)  # noqa: TRY400
        with contextlib.suppress(LinkClosed):
            link.send(Failed(text))
        _safe_end(process)
        return 1
    return 0


def _safe_end(process: LockstepMain | WallMain | None) -> None:
    if process is not None:
        with contextlib.suppress(PalpError, SystemExit, KeyboardInterrupt):
            process.executor.transition(Transition.SHUTDOWN)
        process.close()
