"""A page without a browser: what the server sends is kept, and all that a browser could send can be sent."""

from __future__ import annotations

import html
import http.client
import json
import re
import socket
from collections.abc import Callable
from contextlib import ExitStack, closing
from typing import Any, NamedTuple

from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from tests.support.palp import PATIENCE_S

_ELEMENTS = re.compile(r"parseElements\(String\.raw`(.*?)`\)", re.DOTALL)
_CLIENT = re.compile(r"'client_id': '([^']+)'")


class Answer(NamedTuple):
    """What came of one request."""

    status: int
    body: bytes
    headers: http.client.HTTPMessage


class PageServer:
    """A viewer's server, as a program on this host reaches it.

    Args:
        address: As ``palp view`` prints it.
    """

    def __init__(self, address: str) -> None:
        host, _, self.token = address.removeprefix("http://").partition("/?token=")
        self.host, self.port = host, int(host.rpartition(":")[2])

    @property
    def origin(self) -> str:
        """The page's own."""
        return f"http://{self.host}"

    def connect(self) -> socket.socket:
        """Return a connection on which nothing was sent yet."""
        return socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE_S)

    def ask(self, path: str, method: str = "GET", body: bytes | None = None, **headers: str) -> Answer:
        """Ask as any program would; an underscore in a header's name is a dash."""
        with closing(http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)) as connection:
            named = {name.replace("_", "-"): text for name, text in headers.items()}
            connection.request(method, path, body, named)
            answer = connection.getresponse()
            return Answer(answer.status, answer.read(), answer.headers)

    def raw(self, data: bytes) -> bytes:
        """Send these bytes, and return all that comes until the server hangs up."""
        with self.connect() as connection:
            connection.sendall(data)
            found = b""
            while more := connection.recv(1 << 16):
                found += more
            return found

    def socket_address(self, **query: object) -> str:
        """Return where the socket of a page is."""
        words = {"EIO": 4, "transport": "websocket", **query}
        pairs = "&".join(f"{name}={value}" for name, value in words.items())
        return f"ws://{self.host}/{self.token}/_nicegui_ws/socket.io/?{pairs}"


class PageSocket:
    """One page, opened as a browser opens it.

    Args:
        server: Whose page.
        path: Of it.

    Attributes:
        received: The page, and every message of its socket, as they came.
    """

    def __init__(self, server: PageServer, path: str = "/") -> None:
        page = server.ask(f"/{server.token}{path}").body.decode()
        self.received = [page]
        (client,), (elements,) = _CLIENT.findall(page), _ELEMENTS.findall(page)
        self.elements: dict[str, Any] = json.loads(html.unescape(elements))
        self._client = client
        where = server.socket_address(
            client_id=client, tab_id="t", document_id="d", next_message_id=0, implicit_handshake="true"
        )
        self._opened = ExitStack()
        self.connection: ClientConnection = self._opened.enter_context(
            connect(where, origin=Origin(server.origin), max_size=None)
        )
        self.connection.recv(PATIENCE_S)
        self.connection.send("40")

    def close(self) -> None:
        """Leave."""
        self._opened.close()

    def read(self) -> None:
        """Take one message: elements as they change; a ping is answered."""
        text = str(self.connection.recv(PATIENCE_S))
        self.received.append(text)
        if text == "2":
            self.connection.send("3")
        if text.startswith("42"):
            name, data, *_ = json.loads(text[2:])
            if name == "update":
                self.elements |= {key: value for key, value in data.items() if key != "_id"}

    def until(self, so: Callable[[dict[str, Any]], object]) -> tuple[int, dict[str, Any]]:
        """Read until there is an element of which something is so; return its number and it."""
        while True:
            for number, element in self.elements.items():
                if element is not None and so(element):
                    return int(number), element
            self.read()

    def says(self, words: str) -> str:
        """Read until the page shows these words; return the whole text in which they stand."""
        return str(self.until(lambda element: words in str(element.get("text", "")))[1]["text"])

    def labelled(self, label: str) -> tuple[int, dict[str, Any]]:
        """Return the field, button or box of that label, if it is to be seen."""

        def so(element: dict[str, Any]) -> bool:
            props = element.get("props", {})
            labels = props.get("aria-label"), props.get("label"), element.get("text")
            return "events" in element and label in labels and "hidden" not in element.get("class", ())

        return self.until(so)

    def event(self, found: tuple[int, dict[str, Any]], kind: str, *args: object) -> None:
        """Say that something happened to an element, whatever the page would allow."""
        number, element = found
        listener = next(one for one in element["events"] if one["type"].startswith(kind))
        words = [json.dumps(value) for value in args]
        self.emit(
            "event",
            {"id": number, "client_id": self._client, "listener_id": listener["listener_id"], "args": words},
        )

    def emit(self, name: str, data: object) -> None:
        """Say anything."""
        self.connection.send("42" + json.dumps([name, data]))

    def fill(self, label: str, value: object) -> None:
        """Type into a field."""
        self.event(self.labelled(label), "update:", value)

    def click(self, label: str) -> None:
        """Press a button."""
        self.event(self.labelled(label), "click", {})
