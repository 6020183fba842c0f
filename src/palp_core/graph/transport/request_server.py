"""Answer requests from outside, maps in and maps out, so that nothing a stranger sends does harm."""

from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping
from typing import Any

import msgpack
import zmq

from palp_core.errors import GraphError, NodeError, in_words
from palp_core.graph.transport.private_endpoint import bind_private
from palp_core.graph.transport.requester_socket import readable

Operation = Callable[[dict[str, Any]], dict[str, Any]]
REMEMBERED = 256
LONGEST_ID = 128
MAX_REQUEST_BYTES = 1 << 20


class RequestServer:
    """Operations by node and name on a ROUTER socket, and the replies to requests that may be asked again.

    Requests are maps ``{"op": operation, "node": node, ...}``.

    Args:
        context: The process's.
        endpoint: Where requests are answered.

    Attributes:
        file_descriptor: Becomes readable when :meth:`poll` has something to do.
        stirred: :meth:`poll` may have something to do all the same: sending swallows the descriptor's signal.
    """

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], endpoint: str) -> None:
        self._socket = context.socket(zmq.ROUTER)
        self._socket.setsockopt(zmq.LINGER, 200)
        self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_REQUEST_BYTES)
        bind_private(self._socket, endpoint)
        self.file_descriptor = int(self._socket.getsockopt(zmq.FD))
        self.stirred = True
        self._operations: dict[str, Mapping[str, Operation]] = {}
        self._deferred: dict[str, Collection[str]] = {}
        self._waiting: list[tuple[str, list[bytes], dict[str, Any]]] = []
        self._remembered: OrderedDict[str, bytes | None] = OrderedDict()
        self._also: dict[str, list[list[bytes]]] = {}

    def add(self, node: str, operations: Mapping[str, Operation], deferred: Collection[str] = ()) -> None:
        """Add a node's operations.

        Args:
            node: Whom a request is for; one that names nobody is for the only one there is.
            operations: By name.
            deferred: Those that wait for :meth:`perform`.
        """
        self._operations[node], self._deferred[node] = operations, deferred

    @property
    def waiting(self) -> Collection[str]:
        """Nodes for which a deferred request waits."""
        return {node for node, _, _ in self._waiting} if self._waiting else ()

    def poll(self) -> None:
        """Answer requests, or put them off, without waiting."""
        while readable(self._socket):
            parts = self._socket.recv_multipart()
            reply = self.reply_to(parts[:-1], parts[-1] if len(parts) > 1 else b"")
            if reply is not None:
                self._send(parts[:-1], reply)

    def _send(self, envelope: list[bytes], reply: bytes) -> None:
        self._socket.send_multipart([*envelope, reply])
        self.stirred = True

    def reply_to(self, envelope: list[bytes], payload: bytes) -> bytes | None:
        """Return the reply to a request; None if it is deferred: :meth:`perform` will send it."""
        try:
            request = _unpack(payload)
            node = self._node(request)
            known = self._operations[node]
            if request["op"] not in known:
                raise GraphError(f"no operation {request['op']!r}; operations: {', '.join(sorted(known))}")
            token = request.get("id")
            if isinstance(token, str) and len(token) <= LONGEST_ID:
                if token in self._remembered:
                    if self._remembered[token] is None:
                        self._also.setdefault(token, []).append(envelope)
                    return self._remembered[token]
                self._remembered[token] = None
                if len(self._remembered) > REMEMBERED:
                    self._remembered.popitem(last=False)
            if request["op"] in self._deferred[node]:
                self._waiting.append((node, envelope, request))
                return None
            return self._answer(node, request)[0]
        except Exception as error:  # noqa: BLE001 - whatever a stranger sends must harm nothing
            return _pack({"error": in_words(error)})

    def _node(self, request: dict[str, Any]) -> str:
        named = request.get("node")
        if named is None and len(self._operations) == 1:
            return next(iter(self._operations))
        if not isinstance(named, str) or named not in self._operations:
            raise GraphError(f"no node {named!r} here; there are: {', '.join(sorted(self._operations))}")
        return named

    def _answer(self, node: str, request: dict[str, Any]) -> tuple[bytes, NodeError | None]:
        failure: NodeError | None = None
        try:
            reply = _pack(self._operations[node][request["op"]](request))
        except NodeError as error:  # the node has failed, and whoever runs it must know
            reply, failure = _pack({"error": str(error)}), error
        except Exception as error:  # noqa: BLE001 - as above
            reply = _pack({"error": in_words(error)})
        token = request.get("id")
        if isinstance(token, str) and token in self._remembered:
            self._remembered[token] = reply
        return reply, failure

    def perform(self, node: str | None = None) -> None:
        """Do what waits for a node, or for any, in the order in which it was asked.

        Raises:
            NodeError: A node's handler failed; its caller has been told.
        """
        if not self._waiting:
            return
        mine = [entry for entry in self._waiting if node in (None, entry[0])]
        self._waiting = [entry for entry in self._waiting if entry not in mine]
        failures = []
        for name, envelope, request in mine:
            reply, failure = self._answer(name, request)
            for asker in [envelope, *self._also.pop(request.get("id", ""), [])]:
                self._send(asker, reply)
            failures += [failure] if failure is not None else []
        if failures:
            raise failures[0]

    @property
    def remembered(self) -> dict[str, bytes]:
        """Replies to requests that may be asked again, by their ids."""
        return {token: reply for token, reply in self._remembered.items() if reply is not None}

    def remember(self, replies: Mapping[str, bytes]) -> None:
        """Give these replies to requests with these ids."""
        self._remembered.update(replies)

    def turn_away(self) -> None:
        """Ask those who wait to ask again: another process goes on with the node."""
        waiting, self._waiting = self._waiting, []
        for name, envelope, request in waiting:
            text = f"{name} was swapped for another while this was asked; ask again"
            for asker in [envelope, *self._also.pop(request.get("id", ""), [])]:
                self._send(asker, _pack({"error": text, "again": True}))


def _unpack(payload: bytes) -> dict[str, Any]:
    try:
        request = msgpack.unpackb(payload)
    except Exception as error:  # whatever the bytes are, msgpack's errors have no common base
        raise GraphError(f"a request is a msgpack map, and this is none: {in_words(error)}") from error
    if not isinstance(request, dict) or not isinstance(request.get("op"), str):
        raise GraphError("a request is a msgpack map with a key 'op' that names an operation")
    return request


def _pack(reply: dict[str, Any]) -> bytes:
    return bytes(msgpack.packb(reply, unicode_errors="replace"))
