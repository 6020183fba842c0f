"""Connect again in a thread: a node that must stop a stage waits for no address."""

import threading
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from palp_core.errors import DeviceError


class Closable(Protocol):
    """A connection."""

    def close(self) -> None: ...


C = TypeVar("C", bound=Closable)


class Reconnection(Generic[C]):
    """Try until it succeeds; the connection is fetched by :meth:`fetch`.

    An address without an answer takes seconds to fail, in which the node would read no message.
    """

    def __init__(self, connect: Callable[[], C], pause_s: float = 0.1) -> None:
        self._connect, self._pause_s = connect, pause_s
        self._lock, self._closing = threading.Lock(), threading.Event()
        self._thread: threading.Thread | None = None
        self._found: C | None = None

    def start(self) -> bool:
        """Begin to try; return whether it did not already."""
        with self._lock:
            if self._thread is not None or self._closing.is_set():
                return False
            self._thread = threading.Thread(target=self._run, name="palp-reconnection", daemon=True)
            self._thread.start()
            return True

    def fetch(self) -> C | None:
        """Return the connection once there is one, and to the first who asks."""
        with self._lock:
            found, self._found = self._found, None
            if found is not None:
                self._thread = None
            return found

    def close(self) -> None:
        """End the attempts; a connection that is made after this is closed at once. Waits for nothing."""
        self._closing.set()
        if (found := self.fetch()) is not None:
            found.close()

    def _run(self) -> None:
        while not self._closing.is_set():
            try:
                found = self._connect()
            except DeviceError:
                self._closing.wait(self._pause_s)
                continue
            with self._lock:
                self._found = found
            break
        if self._closing.is_set():
            self.close()
