"""Who may speak to the server: whoever knows the token.

A web page that somebody has open may connect to any port of their own host, and the browser asks nobody. The
SDK's server looks neither at a token nor at who asks, so it listens where no page finds it by trying, at one
of 2^24 addresses and one of many ports, and this door, which does look, passes on what comes through: by the
token, by the name that this host is called, and by the page that asks (``Origin``), if it is one.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import secrets
import threading
from collections.abc import Iterable
from urllib.parse import parse_qs, urlsplit

from palp_core.errors import GraphError
from palp_core.graph.local_access import LOOPBACK_NAMES, is_token, named_host, new_token

HEAD_BYTES = 16 << 10
HEAD_S = 5.0
MOST_VIEWERS = 32
CHUNK_BYTES = 64 << 10
FOXGLOVE = "foxglove.dev"
"""Foxglove's own pages are below it."""
_END_OF_HEAD = b"\r\n\r\n"


def hidden_address() -> str:
    """Return an address of this host that nobody else knows: all of 127.0.0.0/8 is one's own."""
    return str(ipaddress.IPv4Address((127 << 24) + 2 + secrets.randbelow((1 << 24) - 4)))


def is_viewer(origin: str, others: frozenset[str] = frozenset()) -> bool:
    """Tell whether a page may connect: Foxglove's own, one that this host serves, a program's, or one named.

    Args:
        origin: As the browser says it; "" where no page asks.
        others: Origins that are let in besides.

    >>> [is_viewer(origin) for origin in ("", "file://", "https://app.foxglove.dev", "http://localhost:8080")]
    [True, True, True, True]
    >>> [is_viewer(origin) for origin in ("null", "https://evil.example", "https://foxglove.dev.example")]
    [False, False, False]
    """
    if not origin or origin.lower() in others:
        return True
    try:
        parts = urlsplit(origin.lower())
        host = parts.hostname or ""
    except ValueError:
        return False
    if parts.scheme not in ("http", "https"):  # a program's own pages; of a page without a place it is "null"
        return bool(parts.scheme)
    return host in LOOPBACK_NAMES or (parts.scheme == "https" and f".{host}".endswith(f".{FOXGLOVE}"))


def objection(head: str, token: str, hosts: frozenset[str], origins: frozenset[str] = frozenset()) -> str:
    r"""Return why a request is refused, in words; "" if it is not.

    Args:
        head: Request line and headers.
        token: What the request's query must have.
        hosts: By what names this host is called; a name beside them is another site's that leads here.
        origins: Pages that are let in besides those of :func:`is_viewer`.

    >>> asked = "GET /?token=abc HTTP/1.1\r\nHost: localhost:8765\r\n"
    >>> objection(asked, "abc", frozenset({"localhost"}))
    ''
    >>> objection(asked, "xyz", frozenset({"localhost"}))
    'the token is missing or wrong: take the whole address that palp bridge foxglove printed'
    >>> objection(asked, "abc", frozenset({"127.0.0.1"}))
    "this is not 'localhost'"
    """
    request, *lines = head.split("\r\n")
    words = request.split(" ")
    if len(words) != 3 or words[0] != "GET":
        return "not a WebSocket's request"
    headers = [(name.strip().lower(), value.strip()) for name, _, value in (x.partition(":") for x in lines)]
    host = named_host([value for name, value in headers if name == "host"])
    try:
        given = parse_qs(urlsplit(words[1]).query).get("token", [])
    except ValueError:
        return "not a WebSocket's request"
    if host not in hosts:
        return f"this is not '{host[:100]}'"
    if foreign := [value for name, value in headers if name == "origin" and not is_viewer(value, origins)]:
        return f"the page of '{foreign[0][:100]}' is no viewer that is known; if it is yours: --origin"
    if len(given) != 1 or not is_token(given[0], token):
        return "the token is missing or wrong: take the whole address that palp bridge foxglove printed"
    return ""


class Gate:
    """Listens, in a thread of its own, until it is closed.

    Args:
        host: Where.
        port: 0: any free one.
        inner: Host and port of the server behind.
        origins: Pages that are let in besides Foxglove's own and those of this host.

    Attributes:
        address: Where viewers connect, with the token.

    Raises:
        GraphError: The address cannot be had.
    """

    def __init__(self, host: str, port: int, inner: tuple[str, int], origins: Iterable[str] = ()) -> None:
        self._inner = inner
        self._origins = frozenset(origin.lower().rstrip("/") for origin in origins)
        self._token = new_token()
        self._hosts = LOOPBACK_NAMES | {host.lower()}
        self._tasks: set[asyncio.Task[None]] = set()
        self._loop = asyncio.new_event_loop()
        try:
            self._server = self._loop.run_until_complete(
                asyncio.start_server(self._admit, host, port, limit=HEAD_BYTES)
            )
        except (OSError, UnicodeError) as error:
            self._loop.close()
            why = getattr(error, "strerror", None) or str(error)
            raise GraphError(
                f"cannot listen on {host}:{port}: {why}; choose another --port or --host"
            ) from error
        bound: int = self._server.sockets[0].getsockname()[1]
        shown = f"[{host}]" if ":" in host else host
        self.address = f"ws://{shown}:{bound}/?token={self._token}"
        self._thread = threading.Thread(target=self._loop.run_forever, name="gate", daemon=True)
        self._thread.start()

    def close(self) -> None:
        asyncio.run_coroutine_threadsafe(self._end(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _end(self) -> None:
        self._server.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _admit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        try:
            # It is cancelled only by the end of the gate, which asyncio's own callback takes for an error.
            with contextlib.suppress(OSError, asyncio.IncompleteReadError, asyncio.CancelledError):
                await self._serve(reader, writer)
        finally:
            self._tasks.discard(task)
            writer.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            async with asyncio.timeout(HEAD_S):
                head = await reader.readuntil(_END_OF_HEAD)
            refused = objection(head.decode("latin-1"), self._token, self._hosts, self._origins)
        except asyncio.LimitOverrunError:
            refused = "the request is too long"
        if not refused and len(self._tasks) > MOST_VIEWERS:
            refused = f"{MOST_VIEWERS} viewers are connected already"
        if refused:
            body = f"palp bridge foxglove: {refused}\n".encode()
            lines = f"HTTP/1.1 403 Forbidden\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
            writer.write(lines.encode() + body)
            await writer.drain()
            return
        inner_reader, inner_writer = await asyncio.open_connection(*self._inner)
        try:
            inner_writer.write(head)
            ways = (_pass_on(reader, inner_writer), _pass_on(inner_reader, writer))
            running = [asyncio.ensure_future(way) for way in ways]
            try:
                await asyncio.wait(running, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for way in running:
                    way.cancel()
                await asyncio.gather(*running, return_exceptions=True)
        finally:
            inner_writer.close()


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Pass on what comes, no faster than it is taken; the SDK drops what a slow viewer leaves."""
    while data := await reader.read(CHUNK_BYTES):
        writer.write(data)
        await writer.drain()
