"""The end of a viewer that nobody needs: its graph is gone, and no browser is connected."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

from palp_core.graph.clock import monotonic_ns

if TYPE_CHECKING:
    import uvicorn

PATIENCE_S = 60.0
"""So long a browser may be away: a page that is loaded again, or whose host slept, still finds it."""
LOOK_S = 1.0


class Unwatched:
    """For how long nobody has had a use for a viewer.

    Args:
        over: Tells whether what is shown has ended.
        connected: Returns how many browsers are connected.
        patience_s: So long both must last, s.
    """

    def __init__(self, over: Callable[[], bool], connected: Callable[[], int], patience_s: float) -> None:
        self._over, self._connected = over, connected
        self._patience_ns = round(patience_s * 1e9)
        self._since_ns: int | None = None

    def is_so(self, now_ns: int) -> bool:
        """Look at an instant of the machine's clock, ns; tell whether it has lasted long enough."""
        if self._connected() or not self._over():
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = now_ns
        return now_ns - self._since_ns >= self._patience_ns


def end_unwatched(server: uvicorn.Server, over: Callable[[], bool], connected: Callable[[], int]) -> None:
    """Let a server end, from a thread, once what it shows has ended and nobody has looked for a minute."""
    unwatched, pause = Unwatched(over, connected, PATIENCE_S), threading.Event()

    def look() -> None:
        while not server.should_exit:
            server.should_exit = unwatched.is_so(monotonic_ns())
            pause.wait(LOOK_S)

    threading.Thread(target=look, name="palp view: unwatched", daemon=True).start()
