"""A viewer that speaks Foxglove's WebSocket protocol, by nothing of palp's or of the SDK's."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from tests.support.palp import PATIENCE_S

PROTOCOL = Subprotocol("foxglove.sdk.v1")
_MESSAGE, _TIME, _REPLY = 1, 2, 3


class Shown(NamedTuple):
    """A message: its topic, its time and what it says."""

    topic: str
    log_ns: int
    value: dict[str, Any]


class Viewer:
    """A connection; what comes is kept in order until it is asked for."""

    def __init__(self, connection: ClientConnection) -> None:
        self.connection = connection
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.shown: list[Shown] = []
        self.said: list[dict[str, Any]] = []
        self.times_ns: list[int] = []
        self._replies: dict[int, dict[str, Any]] = {}
        self._calls = 0

    def until(self, so: Callable[[], Any]) -> Any:
        """Read until something is so; return it."""
        while not (found := so()):
            self._take(self.connection.recv(timeout=PATIENCE_S))
        return found

    def await_offer(self, *names: str) -> None:
        """Read until topics and services of those names are offered."""
        self.until(lambda: set(names) <= {*self.channels, *self.services})

    def subscribe(self, *topics: str) -> None:
        self.await_offer(*topics)
        ids = [self.channels[topic]["id"] for topic in topics]
        self.send("subscribe", subscriptions=[{"id": id_, "channelId": id_} for id_ in ids])

    def unsubscribe(self, *topics: str) -> None:
        self.send("unsubscribe", subscriptionIds=[self.channels[topic]["id"] for topic in topics])

    def await_message(self, topic: str, so: Callable[[Shown], bool] = lambda _: True) -> Shown:
        """Return the first message of a topic of which something is so."""
        found: Shown = self.until(lambda: next((s for s in self.shown if s.topic == topic and so(s)), None))
        return found

    def parameters(self, *names: str) -> dict[str, Any]:
        """Ask for parameters; of all of them by default."""
        return self._parameters("getParameters", parameterNames=list(names))

    def set_parameters(self, **values: Any) -> dict[str, Any]:
        """Set ``node__parameter`` and return what they are then."""
        wanted = [{"name": f"/{n.replace('__', '.')}", "value": value} for n, value in values.items()]
        return self._parameters("setParameters", parameters=wanted)

    def _parameters(self, operation: str, **fields: Any) -> dict[str, Any]:
        self._calls += 1
        id_ = f"asked {self._calls}"
        self.send(operation, id=id_, **fields)
        answer = self.until(lambda: next((s for s in self.said if s.get("id") == id_), None))
        return {p["name"]: p.get("value") for p in answer["parameters"]}

    def call(self, service: str, request: dict[str, Any]) -> dict[str, Any]:
        """Call a service; ``failed`` tells why it was refused."""
        self.await_offer(service)
        self._calls += 1
        call, encoding = self._calls, b"json"
        head = struct.pack("<BIII", 2, self.services[service]["id"], call, len(encoding))
        self.connection.send(head + encoding + json.dumps(request).encode())
        found: dict[str, Any] = self.until(lambda: self._replies.get(call))
        return found

    def status(self, words: str) -> dict[str, Any]:
        """Return the status that has those words."""
        found: dict[str, Any] = self.until(
            lambda: next((s for s in self.said if s["op"] == "status" and words in s["message"]), None)
        )
        return found

    def send(self, operation: str, **fields: Any) -> None:
        self.connection.send(json.dumps({"op": operation, **fields}))

    def _take(self, data: str | bytes) -> None:
        if isinstance(data, bytes):
            self._take_binary(data)
            return
        said = json.loads(data)
        match said["op"]:
            case "advertise":
                self.channels |= {channel["topic"]: channel for channel in said["channels"]}
            case "unadvertise":
                gone = set(said["channelIds"])
                self.channels = {n: c for n, c in self.channels.items() if c["id"] not in gone}
            case "advertiseServices":
                self.services |= {service["name"]: service for service in said["services"]}
            case "unadvertiseServices":
                gone = set(said["serviceIds"])
                self.services = {n: s for n, s in self.services.items() if s["id"] not in gone}
            case "serviceCallFailure":
                self._replies[said["callId"]] = {"failed": said["message"]}
            case _:
                self.said.append(said)

    def _take_binary(self, data: bytes) -> None:
        if data[0] == _MESSAGE:
            id_, log_ns = struct.unpack_from("<IQ", data, 1)
            topic = next(name for name, channel in self.channels.items() if channel["id"] == id_)
            self.shown.append(Shown(topic, log_ns, json.loads(data[13:])))
        elif data[0] == _TIME:
            self.times_ns.append(struct.unpack_from("<Q", data, 1)[0])
        elif data[0] == _REPLY:
            _, call, length = struct.unpack_from("<III", data, 1)
            self._replies[call] = json.loads(data[13 + length :])


@contextmanager
def viewing(address: str, **options: Any) -> Iterator[Viewer]:
    """Connect, as a viewer that has the address does."""
    with connect(
        address, subprotocols=[PROTOCOL], max_size=None, compression=None, proxy=None,
        open_timeout=PATIENCE_S, close_timeout=1.0, **options,
    ) as connection:  # fmt: skip
        yield Viewer(connection)
