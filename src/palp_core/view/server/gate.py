"""Access to the pages: from this host only, with the token, from the page's own address.

An ASGI application around that of the pages. It looks at every request and every WebSocket before anything
else does: ``Host`` must be this host's own name, ``Origin`` the page's own address, and the first part of the
path the token. So neither cookies nor what a browser sends of itself opens anything.
"""

from __future__ import annotations

from collections.abc import Iterable
from urllib.parse import parse_qs, quote

from palp_core.graph.local_access import AccessPolicy, Refusal
from palp_core.view.server.asgi import App, Message, Receive, Scope, Send

MOST_SOCKETS = 16
MOST_REQUESTS = 64
LONGEST_BODY = 1 << 20
_TRUSTED_FROM_PROXIES = (b"x-forwarded-", b"forwarded", b"x-original-", b"x-rewrite-")
CONTENT_POLICY = (
    "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; object-src 'none'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
"""Nothing is fetched from elsewhere, and nothing can be sent there, whatever a page may hold."""
HEADERS = (
    (b"content-security-policy", CONTENT_POLICY.encode()),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
)


class PageGate:
    """Lets in who has the token of this server; the pages answer below ``/<token>``."""

    def __init__(self, app: App, token: str) -> None:
        self.app = app
        self._policy = AccessPolicy(token, lambda origin, host: origin == f"http://{host}")
        self._sockets = self._requests = 0
        self.refused_count = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        status, text = self._judge(scope)
        if status:
            self.refused_count += status >= 400
            await _refuse(scope, send, status, text)
            return
        scope["headers"] = [
            pair for pair in scope["headers"] if not pair[0].startswith(_TRUSTED_FROM_PROXIES)
        ]
        socket = scope["type"] == "websocket"
        self._sockets += socket
        self._requests += not socket
        try:
            await self.app(scope, _bounded(receive), _with_headers(send))
        finally:
            self._sockets -= socket
            self._requests -= not socket

    @property
    def connected_count(self) -> int:
        """How many browsers are connected: a page of each has a socket."""
        return self._sockets

    def _judge(self, scope: Scope) -> tuple[int, str]:
        """Return the status and text of a refusal; 0 lets the request in."""
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        hosts, origins = (
            [value.decode("latin-1") for name, value in scope["headers"] if name == wanted]
            for wanted in (b"host", b"origin")
        )
        if scope["type"] == "websocket" and not origins:
            origins = [""]
        path = str(scope["path"])
        _, first, *rest = path.split("/") if path.startswith("/") else ("", "")
        if path == "/":
            first, rest = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0], []
        refusal = self._policy.refusal(hosts, origins, [first])
        if refusal is Refusal.HOST:
            return 421, "this server answers to 127.0.0.1 and localhost only"
        if refusal is Refusal.ORIGIN or (not origins and _is_fetched_elsewhere(scope, headers)):
            return 403, "another site's page asked for this"
        if refusal is Refusal.TOKEN:
            return 403, "no token, or a wrong one: open the address that palp view has printed"
        if not rest:
            return 303, f"/{quote(first)}/"
        if any(part in ("..", ".") or "\\" in part or "\0" in part for part in rest):
            return 404, "no such page"
        if _length(headers.get(b"content-length", "0")) > LONGEST_BODY:
            return 413, f"at most {LONGEST_BODY} bytes"
        if self._sockets >= MOST_SOCKETS and scope["type"] == "websocket":
            return 503, f"{MOST_SOCKETS} viewers are connected; close one"
        if self._requests >= MOST_REQUESTS and scope["type"] == "http":
            return 503, "too many requests at once; try again"
        return 0, ""


def _is_fetched_elsewhere(scope: Scope, headers: dict[bytes, str]) -> bool:
    """Return whether another site's page asks; following a link to here does not count."""
    if headers.get(b"sec-fetch-site", "none") in ("none", "same-origin"):
        return False
    return scope.get("method") != "GET" or headers.get(b"sec-fetch-mode") != "navigate"


def _length(text: str) -> int:
    return int(text) if text.isascii() and text.isdigit() and len(text) < 16 else LONGEST_BODY + 1


async def _refuse(scope: Scope, send: Send, status: int, text: str) -> None:
    if scope["type"] == "websocket":  # before it is accepted: HTTP 403
        await send({"type": "websocket.close", "code": 1008, "reason": text})
        return
    headers: list[tuple[bytes, bytes]] = [(b"content-type", b"text/plain; charset=utf-8"), *HEADERS]
    if status == 303:
        headers.append((b"location", text.encode()))
        headers.append((b"cache-control", b"no-store"))
        text = ""
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": f"{text}\n".encode()})


def _bounded(receive: Receive) -> Receive:
    """Return what receives a request whose body is bounded, whatever its header has."""
    taken = 0

    async def take() -> Message:
        nonlocal taken
        message = await receive()
        taken += len(message.get("body", b""))
        return {"type": "http.disconnect"} if taken > LONGEST_BODY else message

    return take


def _with_headers(send: Send) -> Send:
    """Return what sends answers with what a browser is to keep to; a page's own policy stays."""

    async def forward(message: Message) -> None:
        if message["type"] == "http.response.start":
            own: Iterable[tuple[bytes, bytes]] = message.get("headers", ())
            known = {name.lower() for name, _ in own}
            message["headers"] = [*own, *(pair for pair in HEADERS if pair[0] not in known)]
        await send(message)

    return forward
