"""The main function of a node's process: connect, configure, then follow the conductor or the wall clock."""

import contextlib
import gc
import logging
import os
import signal
import socket

from palp_core.errors import NodeError, in_words
from palp_core.graph.log_format import ENDING, begin_log
from palp_core.graph.node.lifecycle import Transition
from palp_core.graph.process.channel import ChannelClosed
from palp_core.graph.process.control_messages import Failed, Hello, Spawn, node_end
from palp_core.graph.process.lockstep_loop import LockstepLoop
from palp_core.graph.process.wall_loop import WallLoop


def run_node(order: Spawn) -> int:
    """Run one node until the supervisor ends it, and return the exit status of its process."""
    begin_log(order.spec.name, order.log_level)
    channel = node_end(f"{order.run_dir}/supervisor.sock")
    channel.send(Hello(order.place, os.getpid()))
    for number in (signal.SIGINT, signal.SIGTERM):  # the loop sees the channel's end at a handler boundary
        signal.signal(number, lambda *_: channel.socket.shutdown(socket.SHUT_RD))
    loop: LockstepLoop | WallLoop | None = None
    try:
        loop = LockstepLoop(order, channel) if order.clock == "sim" else WallLoop(order, channel)
        gc.collect()
        gc.freeze()
        loop.run()
    except ChannelClosed:
        _safe_end(loop)
        return 1
    except BaseException as error:
        text = in_words(error)
        if not (isinstance(error, NodeError) and error.__cause__):  # that one is in the log already
            logging.getLogger("palp").critical("%s", text, exc_info=error, extra=ENDING)
        with contextlib.suppress(ChannelClosed):
            channel.send(Failed(text))
        _safe_end(loop)
        return 1
    return 0


def _safe_end(loop: LockstepLoop | WallLoop | None) -> None:
    if loop is not None:
        with contextlib.suppress(BaseException):
            loop.executor.transition(Transition.SHUTDOWN)
        loop.close()
