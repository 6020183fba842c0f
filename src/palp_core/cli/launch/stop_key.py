"""The key that stops all motion while a launch is in the foreground of a terminal."""

from __future__ import annotations

import contextlib
import os
import select
import termios
import threading
import tty
from collections.abc import Callable
from typing import Any

KEY = b" "


class StopKey:
    """Call back at each press of the space bar; the terminal is as before at the end.

    Args:
        descriptor: Of the terminal.
        press: What to do; it is run on the key's own thread.
    """

    def __init__(self, descriptor: int, press: Callable[[], None]) -> None:
        self._descriptor, self._press = descriptor, press
        self._before: list[Any] | None = None
        self._wake_out, self._wake_in = -1, -1
        self._thread: threading.Thread | None = None

    def start(self) -> bool:
        """Begin to listen; tell whether there is a terminal that listens to us."""
        if not os.isatty(self._descriptor) or not self._in_front():
            return False
        self._before = termios.tcgetattr(self._descriptor)
        tty.setcbreak(self._descriptor)  # Ctrl-C stays what it is
        self._wake_out, self._wake_in = os.pipe()
        self._thread = threading.Thread(target=self._listen, name="palp-stop-key", daemon=True)
        self._thread.start()
        return True

    def stop(self) -> None:
        """Leave the terminal as it was."""
        if self._thread is None:
            return
        os.write(self._wake_in, b"!")
        self._thread.join(1.0)
        os.close(self._wake_in)
        os.close(self._wake_out)
        self._thread = None
        with contextlib.suppress(termios.error, OSError):
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before or [])

    def _in_front(self) -> bool:
        """Tell whether changing the terminal would not stop this process, as it does in the background."""
        try:
            return os.tcgetpgrp(self._descriptor) == os.getpgrp()
        except OSError:  # not the terminal that this process belongs to
            return True

    def _listen(self) -> None:
        while True:
            ready = select.select([self._descriptor, self._wake_out], [], [])[0]
            if self._wake_out in ready:
                return
            try:
                pressed = os.read(self._descriptor, 64)
            except OSError:
                return
            if not pressed:
                return
            if KEY in pressed:
                self._press()
