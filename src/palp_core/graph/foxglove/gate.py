"""The door of the server: it lets in viewers that have the token.

The SDK's server looks neither at a token nor at who asks, so it listens where no page finds it by trying, at
one of 2^24 addresses and one of many ports, and this door, which does look, passes on what comes through.
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
from palp_core.graph.local_access import LOOPBACK_NAMES, AccessPolicy, Refusal, named_host, new_token

HEAD_BYTES = 16 << 10
HEAD_S = 5.0
MOST_VIEWERS = 32
CHUNK_BYTES = 64 << 10
FOXGLOVE = "foxglove.dev"
"""Foxglove's own pages are below it."""
_END_OF_HEAD = b"\r\n\r\n"


def hidden_address() -> str:
    """Return an address of this host that no other program knows: all of 127.0.0.0/8 is one's own."""
    return str(ipaddress.IPv4Address((127 << 24) + 2 + secrets.randbelow((1 << 24) - 4)))


def is_viewer(origin: str, others: frozenset[str] = frozenset()) -> bool:
    """Tell whether a page may connect: Foxglove's own, one of this host, a program's, or one named."""
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


def objection(head: str, policy: AccessPolicy) -> str:
    """Return why a request is refused; "" if it is not."""
    request, *lines = head.split("\r\n")
    words = request.split(" ")
    headers = [(name.strip().lower(), value.strip()) for name, _, value in (x.partition(":") for x in lines)]
    hosts, origins = ([value for name, value in headers if name == wanted] for wanted in ("host", "origin"))
    try:
        method, target, _ = words
        tokens = parse_qs(urlsplit(target).query).get("token", [])
    except ValueError:
        method, tokens = "", []
    if method != "GET":
        return "not a WebSocket's request"
    match policy.refusal(hosts, origins, tokens):
        case Refusal.HOST:
            return f"this is not '{named_host(hosts)[:100]}'"
        case Refusal.ORIGIN:
            page = next(origin for origin in origins if not policy.admits(origin, hosts[0]))
            return f"the page of '{page[:100]}' is no viewer that is known; if it is yours: --origin"
        case Refusal.TOKEN:
            return "the token is missing or wrong: take the whole address that palp bridge foxglove printed"
    return ""


class Gate:
    """Listens, in a thread of its own, until it is closed; ``inner`` is where the server behind is."""

    def __init__(self, host: str, port: int, inner: tuple[str, int], origins: Iterable[str] = ()) -> None:
        self._inner = inner
        others = frozenset(origin.lower().rstrip("/") for origin in origins)
        self._policy = AccessPolicy(
            new_token(), lambda origin, _: is_viewer(origin, others), LOOPBACK_NAMES | {host.lower()}
        )
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
        self.address = f"ws://{shown}:{bound}/?token={self._policy.token}"
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
            refused = objection(head.decode("latin-1"), self._policy)
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
        inner_writer.write(head)
        ways = [
            asyncio.ensure_future(_pass_on(*ends))
            for ends in ((reader, inner_writer), (inner_reader, writer))
        ]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
            inner_writer.close()


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Pass on what comes, no faster than it is taken; the SDK drops what a slow viewer leaves."""
    while data := await reader.read(CHUNK_BYTES):
        writer.write(data)
        await writer.drain()
