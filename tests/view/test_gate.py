"""Who gets in to the pages: attacks on the gate, without a browser and without pages."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from palp_core.graph.local_access import new_token
from palp_core.view.server.gate import LONGEST_BODY, MOST_REQUESTS, MOST_SOCKETS, PageGate

TOKEN = new_token()
PORT = 8123
HOST = (b"host", f"127.0.0.1:{PORT}".encode())
ORIGIN = (b"origin", f"http://127.0.0.1:{PORT}".encode())
Headers = tuple[tuple[bytes, bytes], ...]


class Pages:
    """Takes the place of the pages: notes who got in, and what of a body it is given."""

    def __init__(self) -> None:
        self.scopes: list[Any] = []
        self.body = b""
        self.gone = False
        self.leave: asyncio.Event | None = None

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        self.scopes.append(scope)
        if self.leave is not None:
            await self.leave.wait()
        while scope["type"] == "http" and not self.gone:
            message = await receive()
            self.body += message.get("body", b"")
            self.gone = message["type"] == "http.disconnect"
            if not message.get("more_body"):
                break
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b"in"})


class Asked:
    """What came of one request."""

    def __init__(self) -> None:
        self.messages: list[Any] = []

    async def send(self, message: Any) -> None:
        self.messages.append(message)

    @property
    def status(self) -> int:
        first = self.messages[0]
        return 403 if first["type"] == "websocket.close" else int(first["status"])

    def header(self, name: bytes) -> bytes:
        return bytes(dict(self.messages[0]["headers"]).get(name, b""))


def scope_of(path: str, headers: Headers = (HOST,), query: str = "", kind: str = "http") -> dict[str, Any]:
    return {
        "type": kind, "method": "GET", "path": path, "query_string": query.encode(), "headers": list(headers),
    }  # fmt: skip


async def ask(gate: PageGate, scope: dict[str, Any], *body: bytes) -> Asked:
    parts = list(body) or [b""]

    async def receive() -> dict[str, Any]:
        part = parts.pop(0) if parts else b""
        return {"type": "http.request", "body": part, "more_body": bool(parts)}

    asked = Asked()
    await gate(scope, receive, asked.send)
    return asked


def opened(path: str, headers: Headers = (HOST,), query: str = "", kind: str = "http") -> tuple[int, Pages]:
    pages = Pages()
    asked = asyncio.run(ask(PageGate(pages, TOKEN), scope_of(path, headers, query, kind)))
    return asked.status, pages


def test_who_has_the_token_gets_in() -> None:
    status, pages = opened(f"/{TOKEN}/")
    assert (status, len(pages.scopes)) == (200, 1)
    status, pages = opened(f"/{TOKEN}/_nicegui_ws/socket.io/", (HOST, ORIGIN), kind="websocket")
    assert len(pages.scopes) == 1


PAGE = f"/{TOKEN}/"
EVIL = (b"origin", b"http://evil.example")
WRONG: list[tuple[Any, ...]] = [
    ("/",),
    ("/topics",),
    ("/", (HOST,), "token=wrong"),
    (f"/{new_token()}/",),
    (f"/{TOKEN[:-1]}/",),
    (f"/{TOKEN}x/",),
    ("/tök€n/",),
    ("/topics", (HOST,), f"token={TOKEN}"),
    ("/_nicegui/3.0/static/x.js",),
    ("/_nicegui_ws/socket.io/", (HOST, ORIGIN), "", "websocket"),
    (PAGE, ((b"host", b"evil.example:8123"),)),
    (PAGE, ((b"host", b"localhost.evil.example"),)),
    (PAGE, ((b"host", b"192.168.1.5:8123"),)),
    (PAGE, ()),
    (PAGE, (HOST, (b"host", b"evil.example"))),
    (PAGE, (HOST, EVIL)),
    (PAGE, (HOST, (b"origin", b"http://127.0.0.1:9"))),
    (PAGE, (HOST, (b"origin", b"null"))),
    (f"{PAGE}ws", (HOST, EVIL), "", "websocket"),
    (f"{PAGE}ws", (HOST,), "", "websocket"),
    (PAGE, (HOST, (b"sec-fetch-site", b"cross-site"))),
    (f"{PAGE}files/../../etc/passwd",),
    (f"{PAGE}files/..\\..\\x",),
    (f"{PAGE}files/a\0b",),
    (PAGE, (HOST, (b"content-length", b"9" * 12))),
    (PAGE, (HOST, (b"content-length", b"-1"))),
]
"""No token or a wrong one; another host's or site's name; out of the folder; too long."""


@pytest.mark.parametrize("attack", range(len(WRONG)))
def test_an_attack_does_not_get_in(attack: int) -> None:
    status, pages = opened(*WRONG[attack])
    assert pages.scopes == []
    assert status >= 400


def test_what_a_proxy_would_say_is_not_believed() -> None:
    _, pages = opened(f"/{TOKEN}/", (HOST, (b"x-forwarded-prefix", b"//evil.example"), (b"accept", b"*/*")))
    assert pages.scopes[0]["headers"] == [HOST, (b"accept", b"*/*")]


def test_a_body_without_a_length_is_bounded() -> None:
    pages = Pages()
    parts = [b"x" * (LONGEST_BODY // 2)] * 5
    asyncio.run(ask(PageGate(pages, TOKEN), scope_of(f"/{TOKEN}/"), *parts))
    assert pages.gone
    assert len(pages.body) <= LONGEST_BODY


@pytest.mark.parametrize(("kind", "most"), [("websocket", MOST_SOCKETS), ("http", MOST_REQUESTS)])
def test_no_more_than_so_many_at_once(kind: str, most: int) -> None:
    async def crowd() -> tuple[int, int]:
        pages = Pages()
        pages.leave = asyncio.Event()
        gate = PageGate(pages, TOKEN)
        scope = scope_of(f"/{TOKEN}/x", (HOST, ORIGIN), kind=kind)
        tasks = [asyncio.create_task(ask(gate, dict(scope))) for _ in range(100)]
        await asyncio.wait(tasks, timeout=0)
        while len([task for task in tasks if task.done()]) < 100 - most:
            await asyncio.sleep(0)
        at_once = len(pages.scopes)
        pages.leave.set()
        await asyncio.gather(*tasks)
        await ask(gate, dict(scope))
        return at_once, len(pages.scopes)

    assert asyncio.run(crowd()) == (most, most + 1)  # and when they have gone, there is room again


def test_a_browser_is_asked_to_fetch_nothing_from_elsewhere() -> None:
    asked = asyncio.run(ask(PageGate(Pages(), TOKEN), scope_of(f"/{TOKEN}/")))
    policy = asked.header(b"content-security-policy").decode()
    assert "default-src 'self'" in policy
    assert "http" not in policy
    assert asked.header(b"referrer-policy") == b"no-referrer"
    assert asked.header(b"x-frame-options") == b"DENY"


def test_tokens_are_long_and_not_alike() -> None:
    tokens = {new_token() for _ in range(100)}
    assert (len(tokens), min(map(len, tokens)) >= 32) == (100, True)
