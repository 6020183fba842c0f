"""A press is answered whatever the pages do: the server's loop is not theirs."""

from __future__ import annotations

import asyncio
import os
import threading
from typing import Any

import pytest

from palp_core.errors import GraphError
from palp_core.view.server.asgi import NICE, PageThread, Presses, answer
from tests.support.palp import PATIENCE_S


class Pages:
    """Takes the place of the pages: one of them never returns until it is let, and keeps its thread."""

    def __init__(self) -> None:
        self.stuck, self.let = threading.Event(), threading.Event()
        self.threads: set[str] = set()
        self.niceness: set[int] = set()
        self.lines: list[str] = []

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        self.threads.add(threading.current_thread().name)
        self.niceness.add(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))
        if scope["type"] == "lifespan":
            await receive()
            await send({"type": "lifespan.startup.complete"})
            await receive()
            return
        if scope["path"] == "/token/stuck":
            self.stuck.set()
            assert self.let.wait(PATIENCE_S)
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": scope["path"].encode()})


class Served:
    """Pages behind what a server calls, with the life that a server gives them."""

    def __init__(self, *, low_priority: bool = False) -> None:
        self.pages = Pages()
        self.app = Presses(PageThread(self.pages, low_priority=low_priority))
        self._life: asyncio.Queue[Any] = asyncio.Queue()
        self._up = asyncio.Event()

    async def __aenter__(self) -> Served:
        async def send(message: Any) -> None:
            assert message["type"] == "lifespan.startup.complete"
            self._up.set()

        self._whole = asyncio.create_task(self.app({"type": "lifespan"}, self._life.get, send))
        self._life.put_nowait({"type": "lifespan.startup"})
        await self._up.wait()
        return self

    async def __aexit__(self, *error: object) -> None:
        self.pages.let.set()
        self._life.put_nowait({"type": "lifespan.shutdown"})
        await self._whole

    async def ask(self, path: str, method: str = "POST") -> tuple[int, str]:
        sent: list[Any] = []

        async def receive() -> Any:
            return {"type": "http.request", "body": b""}

        async def send(message: Any) -> None:
            sent.append(message)

        await self.app({"type": "http", "method": method, "path": path}, receive, send)
        return sent[0]["status"], sent[1]["body"].decode()


def test_a_press_is_answered_while_a_page_keeps_its_thread() -> None:
    async def run() -> None:
        async with Served() as served:
            page = asyncio.create_task(served.ask("/token/stuck", "GET"))
            await asyncio.to_thread(served.pages.stuck.wait)
            answer("halt", lambda: "halted")
            assert await served.ask("/token/press/halt") == (200, "halted")
            assert not page.done()
            served.pages.let.set()
            assert await page == (200, "/token/stuck")

    asyncio.run(run())


@pytest.mark.parametrize("low_priority", [False, True])
def test_pages_have_one_thread_which_is_not_the_servers_and_may_give_way(low_priority: bool) -> None:
    async def run() -> tuple[set[str], set[int]]:
        async with Served(low_priority=low_priority) as served:
            await asyncio.gather(*(served.ask(f"/token/{number}", "GET") for number in range(20)))
        return served.pages.threads, served.pages.niceness

    (name,), (niceness,) = asyncio.run(run())
    assert name != threading.current_thread().name
    assert niceness == (max(NICE, os.nice(0)) if low_priority else os.nice(0))
    assert os.getpriority(os.PRIO_PROCESS, threading.get_native_id()) == os.nice(0)  # presses never do


ASKED = {
    ("/token/press/halt", "GET"): (200, "/token/press/halt"),
    ("/token/pressed", "POST"): (200, "/token/pressed"),
    ("/press/halt", "POST"): (200, "/press/halt"),
    ("/token/press", "POST"): (200, "/token/press"),
    ("/token/press/refused", "POST"): (409, "not now"),
    ("/token/press/unknown", "POST"): (404, "no such button"),
    ("/token/press/refused/x", "POST"): (404, "no such button"),
}
"""What is no press is the pages'; a press is refused with the reason."""


def test_only_a_press_is_answered_and_a_refused_one_with_the_reason() -> None:
    def refuse() -> str:
        raise GraphError("not now")

    async def run() -> list[tuple[int, str]]:
        async with Served() as served:
            return [await served.ask(path, method) for path, method in ASKED]

    answer("halt", lambda: "halted")
    answer("refused", refuse)
    assert asyncio.run(run()) == list(ASKED.values())


def test_a_client_that_leaves_takes_its_page_along() -> None:
    """What is cancelled here is cancelled over there: a closed tab leaves nothing behind."""
    left = threading.Event()

    class Waiting(Pages):
        async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
            if scope["type"] == "lifespan":
                await super().__call__(scope, receive, send)
                return
            self.stuck.set()
            try:
                await asyncio.Event().wait()
            finally:
                left.set()

    async def run() -> None:
        served = Served()
        served.pages = Waiting()
        served.app = Presses(PageThread(served.pages))
        async with served:
            page = asyncio.create_task(served.ask("/token/wait", "GET"))
            await asyncio.to_thread(served.pages.stuck.wait)
            page.cancel()
            assert await asyncio.to_thread(left.wait, PATIENCE_S)

    asyncio.run(run())
