"""Applications of ASGI around the pages: presses, which the server answers itself, and the pages' own thread.

Whatever a page does, the server goes on: it decides on its own loop who is let in and what must not wait. A
press is a request of its own, done on a thread that nothing else uses. So it waits neither for a page, nor
for what pages are sent, nor for a swap.
"""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Callable, Coroutine, MutableMapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from palp_core.errors import PalpError

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Coroutine[Any, Any, Message]]
Send = Callable[[Message], Coroutine[Any, Any, None]]
App = Callable[[Scope, Receive, Send], Coroutine[Any, Any, None]]
T = TypeVar("T")

MOST_AT_ONCE = 4
_HEADERS = [(b"content-type", b"text/plain; charset=utf-8"), (b"cache-control", b"no-store")]
_threads = ThreadPoolExecutor(max_workers=MOST_AT_ONCE, thread_name_prefix="palp view: press")
_known: dict[str, Callable[[], str]] = {}
NICE = 10
"""Of pages with low priority, and of the threads that they start."""
END_S = 1.0
"""Longest wait for the end of requests."""


def answer(name: str, press: Callable[[], str]) -> None:
    """Answer presses of a name from now on."""
    _known[name] = press


class Presses:
    """Answers presses, and hands on all else."""

    def __init__(self, app: App) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        name = _pressed(scope)
        if not name:
            await self.app(scope, receive, send)
            return
        status, text = await _done(name)
        await send({"type": "http.response.start", "status": status, "headers": list(_HEADERS)})
        await send({"type": "http.response.body", "body": text.encode()})


def _pressed(scope: Scope) -> str:
    """Return the name of what is pressed; "" if this is no press."""
    if scope["type"] != "http" or scope["method"] != "POST":
        return ""
    _, _, place, *rest = [*str(scope["path"]).split("/"), "", ""]
    return "/".join(rest).rstrip("/") if place == "press" else ""


async def _done(name: str) -> tuple[int, str]:
    press = _known.get(name)
    if press is None:
        return 404, "no such button"
    try:
        return 200, await asyncio.get_running_loop().run_in_executor(_threads, press)
    except PalpError as error:
        return 409, str(error)


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
