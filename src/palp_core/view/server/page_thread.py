"""The pages on an event loop and a thread of their own, so that whatever they do, the server goes on.

A page that takes long to be put up, or one of somebody's own that never returns, keeps only other pages
waiting: who is let in, and what must not wait, is decided on the server's loop.
"""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Coroutine
from typing import Any, TypeVar

from palp_core.view.server.asgi import App, Message, Receive, Scope, Send

NICE = 10
"""Of pages with low priority, and of the threads that they start."""
END_S = 1.0
"""Longest wait for the end of requests."""
T = TypeVar("T")


class PageThread:
    """An ASGI application on a loop of its own, from its lifespan's begin to its end.

    With ``low_priority`` pages compute after all else where cores are scarce; not next to a rig that moves:
    then a press would wait for the pages to let go of the interpreter.
    """

    def __init__(self, app: App, *, low_priority: bool = False) -> None:
        self.app, self._low_priority = app, low_priority
        self._loop: asyncio.AbstractEventLoop | None = None
        self._up = threading.Event()
        self._thread = threading.Thread(target=self._work, name="palp view: pages", daemon=True)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the application answer over there; what it receives and sends goes over this loop."""
        here = asyncio.get_running_loop()

        async def take() -> Message:
            return await _on(here, receive())

        async def forward(message: Message) -> None:
            await _on(here, send(message))

        if scope["type"] == "lifespan":
            self._thread.start()
            await asyncio.to_thread(self._up.wait)
        assert self._loop is not None
        try:
            await _on(self._loop, self.app(scope, take, forward))
        finally:
            if scope["type"] == "lifespan":
                self._loop.call_soon_threadsafe(self._loop.stop)
                await asyncio.to_thread(self._thread.join, END_S)

    def _work(self) -> None:
        if self._low_priority:
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), max(NICE, os.nice(0)))
        with asyncio.Runner() as runner:  # at its end it leaves nothing behind
            self._loop = runner.get_loop()
            asyncio.set_event_loop(self._loop)
            self._up.set()
            self._loop.run_forever()


async def _on(loop: asyncio.AbstractEventLoop, work: Coroutine[Any, Any, T]) -> T:
    """Do something on another thread's loop; if this is cancelled, so is that."""
    return await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(work, loop))
