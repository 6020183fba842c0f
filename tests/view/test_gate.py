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
    """Stands for the pages: notes who got in, and what of a body it is given."""

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


def test_the_printed_address_leads_to_the_page() -> None:
    pages = Pages()
    asked = asyncio.run(ask(PageGate(pages, TOKEN), scope_of("/", query=f"token={TOKEN}")))
    assert (asked.status, asked.header(b"location")) == (303, f"/{TOKEN}/".encode())
    assert pages.scopes == []


WRONG = {
    "no token": ("/", (HOST,), "", "http"),
    "no token in the path": ("/topics", (HOST,), "", "http"),
    "a wrong token": ("/", (HOST,), "token=wrong", "http"),
    "another's token in the path": (f"/{new_token()}/", (HOST,), "", "http"),
    "a part of the token": (f"/{TOKEN[:-1]}/", (HOST,), "", "http"),
    "the token and more": (f"/{TOKEN}x/", (HOST,), "", "http"),
    "a token that is no ASCII": ("/tök€n/", (HOST,), "", "http"),
    "the token as the query of a page": ("/topics", (HOST,), f"token={TOKEN}", "http"),
    "the library's files without the token": ("/_nicegui/3.0/static/x.js", (HOST,), "", "http"),
    "a socket without the token": ("/_nicegui_ws/socket.io/", (HOST, ORIGIN), "", "websocket"),
    "another host's name": (f"/{TOKEN}/", ((b"host", b"evil.example:8123"),), "", "http"),
    "a name that begins like ours": (f"/{TOKEN}/", ((b"host", b"localhost.evil.example"),), "", "http"),
    "an address of the network": (f"/{TOKEN}/", ((b"host", b"192.168.1.5:8123"),), "", "http"),
    "no host": (f"/{TOKEN}/", (), "", "http"),
    "two hosts": (f"/{TOKEN}/", (HOST, (b"host", b"evil.example")), "", "http"),
    "another site": (f"/{TOKEN}/", (HOST, (b"origin", b"http://evil.example")), "", "http"),
    "another port of this host": (f"/{TOKEN}/", (HOST, (b"origin", b"http://127.0.0.1:9")), "", "http"),
    "an origin that is none": (f"/{TOKEN}/", (HOST, (b"origin", b"null")), "", "http"),
    "a socket of another site": (
        f"/{TOKEN}/ws",
        (HOST, (b"origin", b"http://evil.example")),
        "",
        "websocket",
    ),
    "a socket of nobody": (f"/{TOKEN}/ws", (HOST,), "", "websocket"),
    "a picture of another site": (f"/{TOKEN}/", (HOST, (b"sec-fetch-site", b"cross-site")), "", "http"),
    "out of the folder": (f"/{TOKEN}/files/../../etc/passwd", (HOST,), "", "http"),
    "out of the folder by a backslash": (f"/{TOKEN}/files/..\\..\\x", (HOST,), "", "http"),
    "a zero in the path": (f"/{TOKEN}/files/a\0b", (HOST,), "", "http"),
    "too long a body": (f"/{TOKEN}/", (HOST, (b"content-length", b"9" * 12)), "", "http"),
    "a length that is none": (f"/{TOKEN}/", (HOST, (b"content-length", b"-1")), "", "http"),
}


@pytest.mark.parametrize("attack", WRONG)
def test_an_attack_does_not_get_in(attack: str) -> None:
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


def test_a_browser_is_told_to_fetch_nothing_from_elsewhere() -> None:
    asked = asyncio.run(ask(PageGate(Pages(), TOKEN), scope_of(f"/{TOKEN}/")))
    policy = asked.header(b"content-security-policy").decode()
    assert "default-src 'self'" in policy
    assert "http" not in policy
    assert asked.header(b"referrer-policy") == b"no-referrer"
    assert asked.header(b"x-frame-options") == b"DENY"


def test_tokens_are_long_and_not_alike() -> None:
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= 32
