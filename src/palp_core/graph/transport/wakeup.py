"""Wake a node that waits inside its subscription, where a message reaches it soonest, for anything else.

A thread that waits inside ZeroMQ's own receive is woken some 20 us sooner than one that waits for a
descriptor and then receives. But a supervisor's word or a tool's question comes on other descriptors: a
thread watches those, and rings by sending a message of one byte to the subscription. It can keep the time,
too, for a node that hears so much that a limit to each of its waits would cost more than a ring now and then.
"""

import os
import select
import threading
from collections.abc import Sequence
from typing import Any

import zmq

from palp_core.graph.clock import monotonic_ns

RING = b"\0"
ENDPOINT = "inproc://wakeup"
_STOP, _LOOK = b"!", b"?"


class Wakeup:
    """Rings once for what has come, and again when it has been answered and something else comes.

    Args:
        context: The process's ZeroMQ context, in which the subscription connects to :data:`ENDPOINT`.
        descriptors: What to watch.
    """

    def __init__(self, context: zmq.Context[Any], descriptors: Sequence[int]) -> None:
        self._ring = context.socket(zmq.PUB)
        self._ring.setsockopt(zmq.LINGER, 0)
        self._ring.bind(ENDPOINT)
        self._prod_read, self._prod_write = os.pipe()
        self._descriptors = (*descriptors, self._prod_read)
        self._due_ns: int | None = None
        self._answered = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="wakeup", daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while True:
            due_ns = self._due_ns
            timeout_s = None if due_ns is None else max(due_ns - monotonic_ns(), 0) / 1e9
            ready, _, _ = select.select(self._descriptors, (), (), timeout_s)
            if self._prod_read in ready:
                if os.read(self._prod_read, 1) == _STOP:
                    return
                continue  # there is a time to be kept
            self._ring.send(RING)
            self._answered.wait()
            self._answered.clear()

    def ring_at(self, due_ns: int | None) -> None:
        """Ring at that time on the host's monotonic clock, or before, too; None: at no time.

        To be called again when it has rung, before :meth:`rearm`.
        """
        before, self._due_ns = self._due_ns, due_ns
        if before is None and due_ns is not None:
            os.write(self._prod_write, _LOOK)

    def rearm(self) -> None:
        """Say that what it has rung for has been looked at."""
        self._answered.set()

    def close(self) -> None:
        """Stop watching."""
        os.write(self._prod_write, _STOP)
        self._answered.set()
        self._thread.join()
        self._ring.close(linger=0)
        os.close(self._prod_read)
        os.close(self._prod_write)
