"""What a viewer prints: never waited for, and never more than somebody reads.

Graphs and browsers may say nonsense without end, of which libraries print a line each; and nobody may read
those, where standard error is a pipe: then a thread waits for that, and no page does.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
import threading
from collections.abc import Iterator

from palp_core.graph.clock import monotonic_ns

MOST_CHARACTERS = 1 << 16
"""Of a period, and waiting to be written."""
PERIOD_S = 60.0
END_S = 0.5
"""So long the last words may take: whoever does not read them keeps no viewer from its end."""


class Words(io.TextIOBase):
    """A text stream whose writers never wait; what is too much is left out, and counted.

    Args:
        descriptor: Of the file, pipe or terminal where it ends up; it stays open.
        period_s: So long no more than :data:`MOST_CHARACTERS` are taken.
    """

    def __init__(self, descriptor: int, period_s: float = PERIOD_S) -> None:
        self._descriptor, self._period_ns = descriptor, round(period_s * 1e9)
        self._changed = threading.Condition()
        self._waiting: list[str] = []
        self._waiting_count = self._taken_count = self._left_out = 0
        self._begun_ns = monotonic_ns()
        self._over = False
        self._thread = threading.Thread(target=self._work, name="palp view: words", daemon=True)
        self._thread.start()

    def writable(self) -> bool:
        """Return that it is."""
        return True

    def write(self, text: str) -> int:
        """Take a text, or leave it out."""
        given = len(text)
        with self._changed:
            now_ns = monotonic_ns()
            if now_ns - self._begun_ns >= self._period_ns:
                self._begun_ns, self._taken_count = now_ns, 0
            if max(self._taken_count, self._waiting_count) + len(text) > MOST_CHARACTERS:
                self._left_out += 1
            else:
                if self._left_out:
                    text = f"palp view: {self._left_out} more texts were not printed\n{text}"
                    self._left_out = 0
                self._waiting.append(text)
                self._waiting_count += len(text)
                self._taken_count += len(text)
                self._changed.notify()
        return given

    def finish(self) -> None:
        """Write what waits, if somebody takes it; further words are not written."""
        with self._changed:
            self._over = True
            self._changed.notify()
        self._thread.join(END_S)

    def _work(self) -> None:
        with contextlib.suppress(OSError):  # nobody is there to read any more
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._waiting or self._over)
                    text, self._waiting = "".join(self._waiting), []
                if not text:
                    return
                left = text.encode(errors="replace")
                while left:
                    left = left[os.write(self._descriptor, left) :]
                with self._changed:
                    self._waiting_count -= len(text)


@contextlib.contextmanager
def unhurried_words() -> Iterator[None]:
    """Let nobody who writes to standard error wait for whoever reads it."""
    before = sys.stderr
    try:
        descriptor = before.fileno()
    except (AttributeError, OSError, ValueError):  # there is none, or it is no file
        yield
        return
    before.flush()
    words = Words(descriptor)
    sys.stderr = words
    try:
        yield
    finally:
        sys.stderr = before
        words.finish()
