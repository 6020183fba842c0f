"""What must not wait: presses that are answered by the server itself, ahead of all pages.

A press is a request of its own, and is done on a thread that nothing else uses. So it waits neither for a
page that is put up, nor for what pages are sent, nor for a swap.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from palp_core.errors import PalpError
from palp_core.view.server.asgi import App, Receive, Scope, Send

MOST_AT_ONCE = 4
_HEADERS = [(b"content-type", b"text/plain; charset=utf-8"), (b"cache-control", b"no-store")]
_threads = ThreadPoolExecutor(max_workers=MOST_AT_ONCE, thread_name_prefix="palp view: press")
_known: dict[str, Callable[[], str]] = {}


def answer(name: str, press: Callable[[], str]) -> None:
    """Answer presses of a name from now on."""
    _known[name] = press


class Presses:
    """An ASGI application that answers presses, and hands on all else.

    Attributes:
        app: As given.
    """

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
