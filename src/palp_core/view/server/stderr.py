"""Standard error of a viewer: writing to it never waits, and is bounded.

Graphs and browsers may cause errors without end, of which libraries print a line each; and where standard
error is a pipe that is not read, a page must not wait.
"""

from __future__ import annotations

import contextlib
import io
import os
import select
import sys
import threading
from collections.abc import Iterator

from palp_core.graph.clock import monotonic_ns

MOST_CHARACTERS = 1 << 16
"""Written in a period."""
PERIOD_S = 60.0


class NonBlockingStderr(io.TextIOBase):
    """A text stream that leaves out what is too much or cannot be written at once, and counts it."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLOUT)
        self._lock = threading.Lock()
        self._begun_ns = monotonic_ns()
        self._taken_count = self._left_out = 0

    def writable(self) -> bool:
        return True

    def write(self, text: str) -> int:
        with self._lock:  # poll() is of one thread at a time
            self._write(text)
        return len(text)

    def _write(self, text: str) -> None:
        now_ns = monotonic_ns()
        if now_ns - self._begun_ns >= PERIOD_S * 1e9:
            self._begun_ns, self._taken_count = now_ns, 0
        if self._taken_count + len(text) > MOST_CHARACTERS:
            self._left_out += 1
            return
        before = f"palp view: {self._left_out} more texts were not printed\n" if self._left_out else ""
        data = (before + text).encode(errors="replace")
        for begin in range(0, len(data), select.PIPE_BUF):  # a pipe that is ready takes so much at once
            if not self._poll.poll(0):
                self._left_out += 1
                return
            with contextlib.suppress(OSError):  # its reader has gone
                os.write(self._descriptor, data[begin : begin + select.PIPE_BUF])
        self._left_out = 0
        self._taken_count += len(text)


@contextlib.contextmanager
def nonblocking_stderr() -> Iterator[None]:
    """Let writers to standard error never wait for its reader."""
    before = sys.stderr
    try:
        descriptor = before.fileno()
    except (AttributeError, OSError, ValueError):  # there is none, or it is no file
        yield
        return
    before.flush()
    sys.stderr = NonBlockingStderr(descriptor)
    try:
        yield
    finally:
        sys.stderr = before
