"""Ctrl-C and SIGTERM as an event that is looked at between two pieces of work, never in the middle of one."""

from __future__ import annotations

import os
import signal
from types import FrameType, TracebackType
from typing import Any, Self

__all__ = ["Interrupt", "Interrupted"]


class Interrupted(Exception):
    """The user asked for the end.

    Attributes:
        signal: What was received.
    """

    def __init__(self, number: signal.Signals) -> None:
        super().__init__(f"interrupted by {number.name}")
        self.signal = number


class Interrupt:
    """While entered, SIGINT and SIGTERM are noted: :meth:`check` raises, a descriptor becomes readable."""

    def __init__(self) -> None:
        self.descriptor, self._write = os.pipe()
        for end in (self.descriptor, self._write):
            os.set_blocking(end, False)
        self._received: signal.Signals | None = None
        self._before: dict[signal.Signals, Any] = {}
        self._entered = False

    def __enter__(self) -> Self:
        try:
            self._before = {n: signal.signal(n, self._note) for n in (signal.SIGINT, signal.SIGTERM)}
        except ValueError:  # not in the main thread (a notebook's worker): the caller has the signals
            self._before = {}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        os.close(self.descriptor)
        os.close(self._write)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._received = signal.Signals(number)
        os.write(self._write, b"!")

    def check(self) -> None:
        """Raise :class:`Interrupted` if a signal has come."""
        if self._received is not None:
            raise Interrupted(self._received)

    def drain(self) -> None:
        """Make the descriptor quiet again."""
        os.read(self.descriptor, 4096)
