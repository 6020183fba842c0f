"""Wake a node that waits inside its subscription, where a message reaches it soonest, for anything else.

A thread that waits inside ZeroMQ's own receive is woken some 20 us sooner than one that waits for a
descriptor and then receives. But a supervisor's word or a tool's question comes on other descriptors: a
thread watches those, and rings by sending a message of one byte to the subscription.
"""

import os
import select
import threading
from collections.abc import Sequence
from typing import Any

import zmq

RING = b"\0"
ENDPOINT = "inproc://wakeup"


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
        self._stop_read, self._stop_write = os.pipe()
        self._descriptors = (*descriptors, self._stop_read)
        self._answered = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="wakeup", daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while True:
            ready, _, _ = select.select(self._descriptors, (), ())
            if self._stop_read in ready:
                return
            self._ring.send(RING)
            self._answered.wait()
            self._answered.clear()

    def rearm(self) -> None:
        """Say that what it has rung for has been looked at."""
        self._answered.set()

    def close(self) -> None:
        """Stop watching."""
        os.write(self._stop_write, b"!")
        self._answered.set()
        self._thread.join()
        self._ring.close(linger=0)
        os.close(self._stop_read)
        os.close(self._stop_write)
