"""The amplifier, made up: a line for each sample, on a pseudo-terminal, at its rate.

``python amplifier.py`` prints the terminal's name and goes on until the end of its input; say ``load
COUNTS``, ``silence``, ``skip`` or ``speak`` to it.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
import tty

RATE_HZ = 1000
BATCH_S = 0.005


class Amplifier:
    """Writes to a terminal of its own until it is closed.

    Attributes:
        url: The terminal's name.
        counts: What it measures now.
        silent: It says nothing.
        skip: Samples that it leaves out next.
    """

    def __init__(self) -> None:
        self._end, self._other = os.openpty()
        tty.setraw(self._other)
        os.set_blocking(self._end, False)
        self.url = os.ttyname(self._other)
        self.counts, self.silent, self.skip = 100_000, False, 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        index, begun_s = 0, time.monotonic()
        while not self._over.wait(BATCH_S):
            due = int((time.monotonic() - begun_s) * RATE_HZ)
            index, self.skip = index + self.skip, 0
            lines = "".join(f"{n},{self.counts}\n" for n in range(index, due))
            index = max(index, due)
            if lines and not self.silent:
                with contextlib.suppress(BlockingIOError):  # nobody reads: a serial line does not wait either
                    os.write(self._end, lines.encode())

    def close(self) -> None:
        """End it; whoever listens hears that the cable is out."""
        self._over.set()
        self._thread.join()
        os.close(self._end)
        os.close(self._other)


if __name__ == "__main__":
    amplifier = Amplifier()
    print(amplifier.url, flush=True)
    for words in map(str.split, sys.stdin):
        if words[:1] == ["load"]:
            amplifier.counts = int(words[1])
        elif words[:1] == ["skip"]:
            amplifier.skip = 50
        amplifier.silent = words[:1] == ["silence"]
    amplifier.close()
