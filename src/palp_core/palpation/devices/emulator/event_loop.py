"""One thread that serves all wires of an emulated rig: sockets, terminals and timers.

As everything an emulator remembers is touched by this thread only, nothing needs a lock. It waits in
``select`` because a terminal paced to its baud rate and a CAN bus to its bit rate need microseconds, and the
newer calls round time-outs to milliseconds.
"""

import heapq
import itertools
import select
import socket
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import TypeVar

from palp_core.errors import DeviceError

T = TypeVar("T")
Readable = int | socket.socket


class EmulatorLoop:
    """Call back when something is readable or due."""

    def __init__(self) -> None:
        self._readers: dict[int, Callable[[], None]] = {}
        self._timers: list[tuple[int, int, Callable[[], None]]] = []
        self._count = itertools.count()
        self._wake_in, self._wake_out = socket.socketpair()
        self._wake_in.setblocking(False)
        self._wake_out.setblocking(False)
        self._waits_for = [self._wake_in.fileno()]
        self._posted: list[Callable[[], None]] = []
        self._posted_lock = threading.Lock()
        self._running = True
        self._thread = threading.Thread(target=self._run, name="palp-emulator", daemon=True)
        self.failures: list[BaseException] = []
        self._thread.start()

    @staticmethod
    def now_ns() -> int:
        """Return the host's monotonic time."""
        return time.monotonic_ns()

    def add(self, readable: Readable, callback: Callable[[], None]) -> None:
        """Call ``callback`` whenever there is something to read. On the loop's thread only."""
        self._readers[_number(readable)] = callback
        self._waits_for = [self._wake_in.fileno(), *self._readers]

    def remove(self, readable: Readable) -> None:
        """Forget a readable. On the loop's thread only."""
        self._readers.pop(_number(readable), None)
        self._waits_for = [self._wake_in.fileno(), *self._readers]

    def at(self, due_ns: int, callback: Callable[[], None]) -> None:
        """Call once at a time, in the order of times and then of calls. On the loop's thread only."""
        heapq.heappush(self._timers, (due_ns, next(self._count), callback))

    def call(self, function: Callable[[], T]) -> T:
        """Run a function on the loop's thread and return its result; from any thread."""
        if threading.current_thread() is self._thread:
            return function()
        if not self._thread.is_alive():
            raise DeviceError("emulator: stopped; start another")
        future: Future[T] = Future()

        def run() -> None:
            try:
                future.set_result(function())
            except BaseException as error:  # noqa: BLE001 -- handed to the caller
                future.set_exception(error)

        self.post(run)
        return future.result(timeout=10.0)

    def post(self, function: Callable[[], None]) -> None:
        """Run a function on the loop's thread soon; from any thread."""
        with self._posted_lock:
            self._posted.append(function)
        with suppress(BlockingIOError):
            self._wake_out.send(b"\0")

    def stop(self) -> None:
        """End the thread."""
        if self._thread.is_alive():
            self.post(self._end)
            self._thread.join()
        self._wake_in.close()
        self._wake_out.close()

    def _end(self) -> None:
        self._running = False

    def _run(self) -> None:
        while self._running:
            wait_s = 1.0
            if self._timers:
                wait_s = min(1.0, max(0.0, (self._timers[0][0] - time.monotonic_ns()) * 1e-9))
            ready, _, _ = select.select(self._waits_for, [], [], wait_s)
            called = [(number, self._readers.get(number)) for number in ready]
            if self._wake_in.fileno() in ready:
                with suppress(BlockingIOError):
                    self._wake_in.recv(4096)
                with self._posted_lock:
                    posted, self._posted = self._posted, []
                for function in posted:
                    self._guarded(function)
            for number, callback in called:
                if callback is not None and self._readers.get(number) is callback:  # not who got its number
                    self._guarded(callback)
            now_ns = time.monotonic_ns()
            while self._timers and self._timers[0][0] <= now_ns:
                self._guarded(heapq.heappop(self._timers)[2])

    def _guarded(self, callback: Callable[[], None]) -> None:
        """Keep the other wires alive when one fails; the failure is kept for :meth:`Emulator.stop`."""
        try:
            callback()
        except Exception as error:  # noqa: BLE001 -- raised at the end
            self.failures.append(error)


def _number(readable: Readable) -> int:
    return readable if isinstance(readable, int) else readable.fileno()
