"""Ctrl-C, SIGTERM and a closed terminal as an event that is looked at between two pieces of work.

A second request, half a second later, breaks into work that has not looked at the first.
"""

import contextlib
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from types import FrameType, TracebackType
from typing import Any, Self

from palp_core.errors import PalpError
from palp_core.graph.clock import monotonic_ns

INSIST_NS = 500_000_000


class Interrupted(KeyboardInterrupt):
    """The user asked for the end: no failure of what runs."""

    def __init__(self, number: signal.Signals, asked_by: str = "") -> None:
        super().__init__(f"ended by {asked_by}" if asked_by else f"interrupted by {number.name}")
        self.signal, self._asked_by = number, asked_by

    def __reduce__(self) -> tuple[type[Self], tuple[signal.Signals, str]]:
        return type(self), (self.signal, self._asked_by)  # a pool's worker hands it on as it is


class Interrupt:
    """While entered, SIGINT, SIGTERM and SIGHUP are noted: :meth:`check` raises, a descriptor is readable.

    Args:
        breaks_in: A second request raises in the middle of the work.

    Attributes:
        asked_by: Returns what has asked for the end, or "" if nothing but a signal did.
    """

    def __init__(self, *, breaks_in: bool = True) -> None:
        self._breaks_in = breaks_in
        self.second_request = False
        self.asked_by: Callable[[], str] = str
        self.descriptor, self._write = os.pipe()
        for end in (self.descriptor, self._write):
            os.set_blocking(end, False)
        self._received: signal.Signals | None = None
        self._received_ns = 0
        self._raised = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        numbers = [signal.SIGINT, signal.SIGTERM]
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as under nohup
            numbers.append(signal.SIGHUP)
        try:
            self._before = {number: signal.signal(number, self._note) for number in numbers}
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
        second = self._received is not None and monotonic_ns() - self._received_ns > INSIST_NS
        if self._received is None:
            self._received, self._received_ns = signal.Signals(number), monotonic_ns()
        self.second_request = self.second_request or second
        with contextlib.suppress(BlockingIOError):
            os.write(self._write, b"!")
        if second and self._breaks_in and not self._raised:
            self.check()

    @property
    def requested(self) -> bool:
        """Whether the end was asked for."""
        return self._received is not None

    def check(self) -> None:
        """Raise :class:`Interrupted` if a signal has come."""
        if self._received is not None:
            self._raised = True
            raise Interrupted(self._received, self.asked_by())

    def drain(self) -> None:
        """Make the descriptor quiet again."""
        os.read(self.descriptor, 4096)


KILL_NS = 5_000_000_000
"""From the friendly request to the next, less friendly one."""

FORCED_TIMEOUT_NS = 500_000_000
"""The same for a user who has asked twice: enough for a safe state, if the node is able to reach it."""


class GracePeriod:
    """The time that one step of the end may take."""

    def __init__(self, interrupt: Interrupt) -> None:
        self.ending = False
        self._interrupt = interrupt
        self._start_ns = 0

    def start(self) -> None:
        if not self.ending:
            self.renew()

    def renew(self) -> None:
        self.ending = True
        self._start_ns = monotonic_ns()

    @property
    def expired(self) -> bool:
        return monotonic_ns() - self._start_ns >= (
            FORCED_TIMEOUT_NS if self._interrupt.second_request else KILL_NS
        )


@contextlib.contextmanager
def ended_after(shutdown: Callable[[int], object], order: Sequence[int]) -> Iterator[None]:
    """End every node after the block, in that order; one that fails keeps no other from its safe state."""
    failures = []
    try:
        yield
    finally:
        for index in order:
            try:
                shutdown(index)
            except PalpError as error:
                failures.append(error)
    if failures:
        raise failures[0]
