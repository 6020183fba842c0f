"""A small HTTP server's side of one connection: GET, answered in one write and kept alive."""

from collections.abc import Callable


class Http:
    """Answer requests with the bytes that a page function returns; None is 404.

    Header and body leave in one write: in two, delayed acknowledgement holds the body back for 40 ms.
    """

    def __init__(self, page: Callable[[str, int], bytes | None], content_type: str) -> None:
        self._page, self._type = page, content_type
        self._rest = b""
        self.greeting, self.ready_ns = b"", 0

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Answer every complete request."""
        *requests, self._rest = (self._rest + data).split(b"\r\n\r\n")
        return b"".join(self._answer(request, now_ns) for request in requests)

    def _answer(self, request: bytes, now_ns: int) -> bytes:
        words = request.split(b"\r\n", 1)[0].decode("ascii", "replace").split()
        body = self._page(words[1], now_ns) if len(words) == 3 and words[0] == "GET" else None
        status = "200 OK" if body is not None else "404 Not Found"
        body = body if body is not None else b""
        head = f"HTTP/1.1 {status}\r\nContent-Type: {self._type}\r\nContent-Length: {len(body)}\r\n\r\n"
        return head.encode("ascii") + body
