"""Answer requests from outside, maps in and maps out: each is read as a type before anything looks at it.

What is kept for those who ask is bounded in bytes.
"""

from collections import OrderedDict, deque
from collections.abc import Callable, Collection, Mapping
from typing import Annotated, Any, Generic, NamedTuple, TypeVar

import msgpack
import msgspec
import zmq

from palp_core.errors import GraphError, NodeError, SchemaMismatch, in_words
from palp_core.graph.messages.message import decode_any
from palp_core.graph.transport.zmq_sockets import InFlightBytes, bind_private, readable

LONGEST_ID = 128
_RCVMORE = int(zmq.RCVMORE)  # an enum costs a microsecond a call
MAX_REQUEST_BYTES = 1 << 20
MOST_AT_ONCE = 100
"""Requests after which a loop does its other work."""

REMEMBERED = 256
REMEMBERED_BYTES = 16 << 20
LONGEST_REMEMBERED_BYTES = 1 << 20
MOST_WAITING = 1000
MOST_WAITING_BYTES = 16 << 20
MOST_ASKERS = 64
"""Who asked the same again and waits for the reply; the earliest have given up by then."""

LONGEST_ENVELOPE_BYTES = 1 << 10
LARGE_REPLY_BYTES = 64 << 10
REPLY_BYTES = 64 << 20
"""Of large replies that those who asked have not taken yet."""

TOO_MANY_REPLIES = "too many large replies wait to be taken; take them and ask again"


class NodeRequest(msgspec.Struct, frozen=True, kw_only=True):
    """What every request has; a subclass adds what an operation needs."""

    op: str
    node: str | None = None  # None: the only one there is
    # the asker's own, if it may ask again; what changes something is done once for it
    id: Annotated[str, msgspec.Meta(max_length=LONGEST_ID)] | None = None


R = TypeVar("R", bound=NodeRequest)


class NodeOperation(Generic[R]):
    def __init__(self, wants: type[R], answer: Callable[[R], dict[str, Any]]) -> None:
        self._wants, self._answer = wants, answer

    def check(self, payload: bytes) -> None:
        decode_any(self._wants, payload)

    def answer(self, payload: bytes) -> dict[str, Any]:
        return self._answer(decode_any(self._wants, payload))


NodeOperations = Mapping[str, NodeOperation[Any]]


class _Waiting(NamedTuple):
    node: str
    request: NodeRequest
    payload: bytes
    askers: deque[list[bytes]]


class RequestServer:
    """Operations by node and name on a ROUTER socket, and the replies to requests that may be asked again.

    Attributes:
        file_descriptor: Becomes readable when :meth:`poll` has something to do.
        poll_pending: It may have something to do all the same: sending swallows the descriptor's signal.
    """

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], endpoint: str) -> None:
        self.socket = self._socket = context.socket(zmq.ROUTER)
        self._socket.setsockopt(zmq.LINGER, 200)
        self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_REQUEST_BYTES)
        bind_private(self._socket, endpoint)
        self.file_descriptor = int(self._socket.getsockopt(zmq.FD))
        self.poll_pending = True
        self._operations: dict[str, NodeOperations] = {}
        self._deferred: dict[str, Collection[str]] = {}
        self._waiting: list[_Waiting] = []
        self._by_token: dict[str, _Waiting] = {}
        self._waiting_bytes = 0
        self._remembered: OrderedDict[str, bytes] = OrderedDict()
        self._remembered_bytes = 0
        self._in_flight = InFlightBytes(REPLY_BYTES)
        self._is_running = False

    def add(self, node: str, operations: NodeOperations, deferred: Collection[str] = ()) -> None:
        self._operations[node], self._deferred[node] = operations, deferred

    @property
    def waiting(self) -> Collection[str]:
        return {entry.node for entry in self._waiting} if self._waiting else ()

    def poll(self, most: int = MOST_AT_ONCE, on_deferred: Callable[[], None] = lambda: None) -> None:
        """Answer or defer requests without waiting; beyond so many it is pending."""
        if self._is_running:
            while (entry := self._next(None)) is not None:
                self._run_one(entry)
        for _ in range(most):
            if not readable(self._socket):
                return
            parts = [self._socket.recv()]
            while self._socket.getsockopt(_RCVMORE):
                parts.append(self._socket.recv())
            payload = parts.pop() if len(parts) > 1 else b""
            reply = self.reply_to(parts, payload)
            if reply is not None:
                self._send(parts, reply)
            else:
                on_deferred()
        self.poll_pending = True

    def _send(self, envelope: list[bytes], reply: bytes) -> None:
        self.poll_pending = True
        if len(reply) < LARGE_REPLY_BYTES:
            self._socket.send_multipart([*envelope, reply])
        elif self._in_flight.has_room(len(reply)):
            self._socket.send_multipart(envelope, zmq.SNDMORE)
            self._in_flight.send(self._socket, reply)
        else:
            self._socket.send_multipart([*envelope, _pack({"error": TOO_MANY_REPLIES})])

    def reply_to(self, envelope: list[bytes], payload: bytes) -> bytes | None:
        """Return the reply to a request; None if it is deferred: :meth:`run_deferred` will send it."""
        try:
            return self._reply_to(envelope, payload)
        except Exception as error:  # noqa: BLE001 - whatever a stranger sends must harm nothing
            return _pack({"error": in_words(error)})

    def _reply_to(self, envelope: list[bytes], payload: bytes) -> bytes | None:
        request = _read(payload)
        node = self._node(request)
        known = self._operations[node]
        if request.op not in known:
            raise GraphError(f"no operation {request.op!r}; operations: {', '.join(sorted(known))}")
        deferred = request.op in self._deferred[node]
        if deferred and request.id is not None:
            if request.id in self._remembered:
                return self._remembered[request.id]
            if request.id in self._by_token:
                self._by_token[request.id].askers.append(_checked(envelope))
                return None
        if not deferred or self._is_running:
            return self._answer(node, request.op, payload)[0]
        known[request.op].check(payload)
        self._defer(_Waiting(node, request, payload, deque([_checked(envelope)], MOST_ASKERS)))
        return None

    def _defer(self, entry: _Waiting) -> None:
        size = self._waiting_bytes + len(entry.payload)
        if len(self._waiting) >= MOST_WAITING or size > MOST_WAITING_BYTES:
            raise GraphError(
                f"{len(self._waiting)} requests wait for {entry.node} and the others here already; ask later"
            )
        self._waiting.append(entry)
        self._waiting_bytes = size
        if entry.request.id is not None:
            self._by_token[entry.request.id] = entry

    def _next(self, node: str | None) -> _Waiting | None:
        """Return what has waited longest for a node, or for any."""
        entry = next((entry for entry in self._waiting if node in (None, entry.node)), None)
        if entry is not None:
            self._waiting.remove(entry)
            self._waiting_bytes -= len(entry.payload)
        return entry

    def _node(self, request: NodeRequest) -> str:
        if request.node is None and len(self._operations) == 1:
            return next(iter(self._operations))
        if request.node is None or request.node not in self._operations:
            raise GraphError(
                f"no node {request.node!r} here; there are: {', '.join(sorted(self._operations))}"
            )
        return request.node

    def _answer(self, node: str, operation: str, payload: bytes) -> tuple[bytes, NodeError | None]:
        """Answer by the class that has the node's place now, perhaps another than when it was asked."""
        try:
            return _pack(self._operations[node][operation].answer(payload)), None
        except NodeError as error:  # the node has failed; its loop raises it
            return _pack({"error": str(error)}), error
        except Exception as error:  # noqa: BLE001 - as in reply_to
            return _pack({"error": in_words(error)}), None

    def run_deferred(self, node: str | None = None) -> None:
        """Do what waits for a node, or for any, in its order; what is asked meanwhile does not wait."""
        if not self._waiting:
            return
        self._is_running = True
        try:
            failures = []
            while (entry := self._next(node)) is not None:
                failures += [failure] if (failure := self._run_one(entry)) is not None else []
        finally:
            self._is_running = False
        if failures:
            raise failures[0]

    def _run_one(self, entry: _Waiting) -> NodeError | None:
        reply, failure = self._answer(entry.node, entry.request.op, entry.payload)
        self._send_all(entry, reply)
        if entry.request.id is not None:
            self._remember(entry.request.id, reply)
        return failure

    def _send_all(self, entry: _Waiting, reply: bytes) -> None:
        """Reply to all who have asked for one thing, those included who asked while it was done."""
        if entry.request.id is not None:
            del self._by_token[entry.request.id]
        for asker in entry.askers:
            self._send(asker, reply)

    @property
    def remembered(self) -> dict[str, bytes]:
        """Replies to requests that may be asked again, by their ids."""
        return dict(self._remembered)

    def remember(self, replies: Mapping[str, bytes]) -> None:
        for token, reply in replies.items():
            self._remember(token, reply)

    def _remember(self, token: str, reply: bytes) -> None:
        if len(reply) > LONGEST_REMEMBERED_BYTES:
            reply = _pack(
                {"error": f"this was done; its reply of {len(reply)} bytes is too long to be repeated"}
            )
        self._remembered_bytes += len(reply) - len(self._remembered.pop(token, b""))
        self._remembered[token] = reply
        while len(self._remembered) > REMEMBERED or self._remembered_bytes > REMEMBERED_BYTES:
            self._remembered_bytes -= len(self._remembered.popitem(last=False)[1])

    def reject_with_retry(self) -> None:
        """Let those who wait ask again: another process goes on with the node."""
        while (entry := self._next(None)) is not None:
            text = f"{entry.node} was swapped for another while this was asked; ask again"
            self._send_all(entry, _pack({"error": text, "again": True}))


def _read(payload: bytes) -> NodeRequest:
    try:
        return decode_any(NodeRequest, payload)
    except SchemaMismatch as error:
        raise GraphError(
            f"a request is a msgpack map with a key 'op' that names an operation: {error}"
        ) from error


def _checked(envelope: list[bytes]) -> list[bytes]:
    if sum(map(len, envelope)) > LONGEST_ENVELOPE_BYTES:
        raise GraphError(
            f"request: its envelope exceeds {LONGEST_ENVELOPE_BYTES} bytes; call through fewer relays"
        )
    return envelope


def _pack(reply: dict[str, Any]) -> bytes:
    return bytes(msgpack.packb(reply, unicode_errors="replace"))
