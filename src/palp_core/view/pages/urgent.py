"""A button for what must not wait: one click or the space bar, without the page's socket.

A press is a request of its own, sent by the browser straight to the server and answered on a thread that
nothing else uses. So it needs no reload, works while the page's socket is away or has just come back, and
waits neither for a swap nor for a page that loads.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from fastapi import Response
from nicegui import app
from nicegui.element import Element

from palp_core.errors import PalpError

_threads = ThreadPoolExecutor(max_workers=4, thread_name_prefix="palp view: urgent")
_presses: dict[str, Callable[[], str]] = {}


class UrgentButton(Element, component="urgent_button.js"):  # type: ignore[misc, call-arg]
    """A button that is pressed by one click or by the space bar, wherever on the page one is but in a field.

    Args:
        name: By which the server knows it; the buttons of one name on several pages are one.
        label: What stands on it.
        press: What it does, on a thread of its own; returns what came of it, in words.
    """

    def __init__(self, name: str, label: str, press: Callable[[], str]) -> None:
        super().__init__()
        _presses[name] = press
        self._props.update(name=name, label=label)

    def allow(self, refusal: str) -> None:
        """Let it be pressed if there is no refusal; else it says why not."""
        if self._props.get("refusal", "") != refusal:
            self._props["refusal"] = refusal
            self.update()

    def forget(self) -> None:
        """Say no longer what came of the last press: something else has come since."""
        self.run_method("tell", "", "")


def serve_presses() -> None:
    """Answer the requests of all such buttons."""

    @app.post("/press/{name}")  # type: ignore[untyped-decorator]
    async def pressed(name: str) -> Response:
        press = _presses.get(name)
        if press is None:
            return _said("no such button", 404)
        try:
            return _said(await asyncio.get_running_loop().run_in_executor(_threads, press), 200)
        except PalpError as error:
            return _said(str(error), 409)


def _said(text: str, status: int) -> Any:
    headers = {"cache-control": "no-store"}
    return Response(text, status_code=status, media_type="text/plain", headers=headers)
