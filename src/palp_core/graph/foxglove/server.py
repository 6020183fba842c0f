"""``palp bridge foxglove``: a running graph over Foxglove's WebSocket, from a process of its own."""

from __future__ import annotations

import contextlib
import json
import logging
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any, NamedTuple, Self

import foxglove
from foxglove import Parameter
from foxglove.websocket import Capability, ChannelView, Client, ServerListener, WebSocketServer

from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.bag.forms import json_form
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.graph_reader import KIND_OFFSET, GraphReader
from palp_core.graph.discovery.running_graph import Answers, RunningGraph, hidden
from palp_core.graph.foxglove import log_entries
from palp_core.graph.foxglove.gate import Gate, hidden_address
from palp_core.graph.foxglove.graph_access import (
    Description,
    GraphAccess,
    ServiceType,
    describe,
    full_names,
    schema_text,
    to_json,
)
from palp_core.graph.messages.builtin import NodeEvent
from palp_core.graph.messages.frame import Frame, Kind, parse
from palp_core.graph.messages.message import decode
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.messages.topic import Topic

WAIT_MS = 20
TIME_NS = 10_000_000
RETRY_NS = 3_000_000_000
HISTORY_S = 3.0
BACKLOG = 512
"""Messages that wait for a viewer; what is beyond replaces the oldest."""
LOG_KEPT = 500
_NODE_EVENT = schema_of(NodeEvent).hash_text
_CAPABILITIES = [Capability.Parameters, Capability.Services, Capability.Time, Capability.ConnectionGraph]


class SubscriptionChange(NamedTuple):
    viewer: int
    topic: str
    begins: bool


class Viewers(ServerListener):
    def __init__(self, access: GraphAccess) -> None:
        self._access = access
        # In order, who has begun or ceased to look at what, and why parameters were not set.
        self.wanted: SimpleQueue[SubscriptionChange | str] = SimpleQueue()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self.wanted.put(SubscriptionChange(client.id, channel.topic, begins=True))

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        self.wanted.put(SubscriptionChange(client.id, channel.topic, begins=False))

    def on_get_parameters(
        self, client: Client, param_names: list[str], request_id: str | None = None
    ) -> list[Parameter]:
        return as_parameters(self._access.parameters(param_names))

    def on_set_parameters(
        self, client: Client, parameters: list[Parameter], request_id: str | None = None
    ) -> list[Parameter]:
        """Set them, and answer with what they are then; why one is refused comes as a status."""
        wanted = {parameter.name: parameter.get_value() for parameter in parameters}
        try:
            self._access.set_parameters(wanted)
        except GraphError as error:
            self.wanted.put(str(error))
        return as_parameters(self._access.parameters(wanted))


def as_parameters(values: Mapping[str, Any]) -> list[Parameter]:
    """Return parameters as the SDK has them; what it has no type for is JSON text."""
    found = []
    for name, value in values.items():
        try:
            found.append(Parameter(name, value=value))
        except TypeError:  # as a null within a mapping
            found.append(Parameter(name, value=json.dumps(value)))
    return found


class ThinnedTopic:
    """The messages of a topic that are shown, so many a second of the machine's clock at most; 0: all.

    Whatever is left out, the latest is shown.
    """

    def __init__(self, fastest_hz: float) -> None:
        self._period_ns = round(1e9 / fastest_hz) if fastest_hz else 0
        self._due_ns = 0
        self._ready: list[bytes] = []
        self._held: bytes | None = None
        self._last = (-1, 0)

    def take(self, raw: bytes, now_ns: int) -> None:
        if raw[raw.find(0) + KIND_OFFSET] != Kind.DATA:
            return
        if now_ns < self._due_ns:
            self._held = raw
            return
        self._ready.append(raw)
        self._held, self._due_ns = None, now_ns + self._period_ns

    def due(self, now_ns: int) -> list[Frame]:
        """Return the messages that are due; of a publisher that moves none comes after its successor's."""
        if self._held is not None and now_ns >= self._due_ns:
            self.take(self._held, now_ns)
        ready, self._ready = self._ready, []
        found = []
        for raw in ready:
            with contextlib.suppress(SchemaMismatch):  # another version's; the readers count such frames
                frame = parse(raw)
                if (frame.epoch, frame.sequence) > self._last:
                    self._last = (frame.epoch, frame.sequence)
                    found.append(frame)
        return found


class _Shown(NamedTuple):
    topic: Topic
    channel: foxglove.Channel
    to_json: Callable[[bytes | memoryview], bytes]


class FoxgloveServer:
    """Shows a running graph to any number of viewers. A topic is read while one of them looks at it.

    ``operate`` lets viewers change something where something real moves, too; ``origins`` are pages that may
    connect besides Foxglove's own and those of this host. It can be had at ``address``.
    """

    def __init__(
        self,
        graph: RunningGraph,
        *,
        host: str,
        port: int,
        fastest_hz: float = 60.0,
        read_only: bool = False,
        operate: bool = False,
        origins: Iterable[str] = (),
    ) -> None:
        self._access = GraphAccess(graph, read_only=read_only, operate=operate)
        self._viewers = Viewers(self._access)
        self._reader = GraphReader(graph, on_change=self._describe)
        self._fastest_hz = fastest_hz
        self._thinned: dict[str, ThinnedTopic] = {}
        self._topics: dict[str, Topic] = {}
        self._shown: dict[str, _Shown] = {}
        self._services: dict[str, ServiceType] = {}
        self._looking: Counter[str] = Counter()
        self._entries: deque[tuple[int, bytes]] = deque(maxlen=LOG_KEPT)
        self._noted: dict[str, tuple[int, int]] = {}
        self._silent: frozenset[str] = frozenset()
        self._describing: Future[Description] | None = None
        self._described_again = False
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="describe")
        self._clock_ns, self._broadcast_ns = 0, 0
        self._next_time_ns, self._retry_ns = 0, 0
        logging.getLogger("foxglove").setLevel(logging.CRITICAL)  # a viewer that left unasked is no news
        self._context = foxglove.Context()
        self._log = foxglove.Channel(log_entries.LOG, schema=log_entries.SCHEMA, context=self._context)
        inner = hidden_address()
        self._server: WebSocketServer = foxglove.start_server(
            name=f"palp: {graph.record.graph}", host=inner, port=0, context=self._context,
            session_id=graph.record.id, capabilities=_CAPABILITIES, supported_encodings=["json"],
            server_listener=self._viewers, message_backlog_size=BACKLOG,
        )  # fmt: skip
        try:
            self._gate = Gate(host, port, (inner, self._server.port), origins)
        except GraphError:
            self._server.stop()
            self._reader.close()
            raise
        self.address = self._gate.address
        self._take(describe(graph))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._gate.close()
        self._server.stop()
        self._pool.shutdown(cancel_futures=True)
        self._reader.close()

    @property
    def ended(self) -> bool:
        return self._reader.ended

    @property
    def refusal(self) -> str:
        """Why viewers may change nothing just now, in words; "" if they may."""
        return self._access.refusal()

    def turn(self) -> None:
        """Show what has arrived, after waiting for it a little; see whether the graph has changed."""
        while not self._viewers.wanted.empty():
            wanted = self._viewers.wanted.get()
            if isinstance(wanted, str):
                self._server.publish_status(wanted, foxglove.StatusLevel.Error)
            else:
                self._on_subscription(wanted)
        self._reader.receive(WAIT_MS)
        now_ns = monotonic_ns()
        for frame in [frame for thinned in self._thinned.values() for frame in thinned.due(now_ns)]:
            self._clock_ns = max(self._clock_ns, frame.stamp_ns)
            self._broadcast_time()
            self._show(frame)
        self._broadcast_time()
        self._take_description()

    def _read(self, topics: Iterable[Topic], fastest_hz: float) -> None:
        for topic in topics:
            if topic.name not in self._thinned:
                thinned = self._thinned[topic.name] = ThinnedTopic(fastest_hz)
                self._reader.follow([topic], thinned.take)

    def _leave(self, name: str) -> None:
        if self._thinned.pop(name, None) is not None:
            self._reader.leave([name])

    def _broadcast_time(self) -> None:
        """Broadcast the graph's time before what is shown of it: viewers take it for the time of that."""
        now_ns = monotonic_ns()
        if self._clock_ns > self._broadcast_ns and now_ns >= self._next_time_ns:
            self._next_time_ns, self._broadcast_ns = now_ns + TIME_NS, self._clock_ns
            self._server.broadcast_time(self._broadcast_ns)

    def _on_subscription(self, change: SubscriptionChange) -> None:
        """Read a topic from the first viewer that looks at it to the last; each gets what is latched."""
        self._looking[change.topic] += 1 if change.begins else -1
        if not self._looking[change.topic]:
            del self._looking[change.topic]
        if change.begins and change.topic == log_entries.LOG:
            for stamp_ns, text in self._entries:
                self._log.log(text, log_time=stamp_ns, sink_id=change.viewer)
        shown = self._shown.get(change.topic)
        if shown is None or not (change.begins or change.topic not in self._looking):
            return
        if change.begins:
            self._read([shown.topic], self._fastest_hz)
            for frame in self._history(shown.topic):
                self._send(shown, frame, change.viewer)
        elif not log_entries.is_logged(shown.topic.type_hash):
            self._leave(change.topic)

    def _history(self, topic: Topic) -> list[Frame]:
        if not topic.latched_depth or topic.node in self._silent:
            return []  # of who is silent it comes when the node answers again
        try:
            return self._access.graph.history(topic.node, topic.name, timeout_s=HISTORY_S)
        except GraphError:
            return []

    def _show(self, frame: Frame) -> None:
        topic = self._topics.get(frame.topic)
        if topic is None:
            return
        if log_entries.is_logged(topic.type_hash):
            self._note(frame, topic)
        shown = self._shown.get(frame.topic)
        if shown is not None and frame.topic in self._looking:
            self._send(shown, frame)

    def _send(self, shown: _Shown, frame: Frame, viewer: int | None = None) -> None:
        with contextlib.suppress(SchemaMismatch):  # of another version of its type: its readers count it
            shown.channel.log(shown.to_json(frame.payload), log_time=max(frame.stamp_ns, 0), sink_id=viewer)

    def _note(self, frame: Frame, topic: Topic) -> None:
        """Write what has happened into the log; changed parameters are sent as such, too."""
        point = (frame.epoch, frame.sequence)
        entry = log_entries.entry_of(frame, topic.type_hash)
        if entry is None or point <= self._noted.get(frame.topic, (-1, 0)):
            return  # or it came with the history
        self._noted[frame.topic] = point
        self._entries.append((max(frame.stamp_ns, 0), json.dumps(entry).encode()))
        stamp_ns, text = self._entries[-1]
        self._log.log(text, log_time=stamp_ns)
        if topic.type_hash == _NODE_EVENT:
            event = decode(NodeEvent, frame.payload)
            if event.kind == "parameters":
                changed = {name: new for name, (_, new) in json.loads(event.data).items()}
                self._server.publish_parameter_values(as_parameters(full_names({topic.node: changed})))

    def _describe(self) -> None:
        """Ask the nodes what the graph is made of; what is shown goes on meanwhile."""
        if self._describing is None:
            self._described_again = False
            self._describing = self._pool.submit(describe, self._access.graph)
        else:
            self._described_again = True

    def _take_description(self) -> None:
        """Show the graph as described; nodes that did not answer, as one that starts, are asked again."""
        if self._describing is not None and self._describing.done():
            self._take(self._describing.result())
            self._describing = None
            self._retry_ns = monotonic_ns() + RETRY_NS
        is_due = self._described_again or (self._silent and monotonic_ns() >= self._retry_ns)
        if self._describing is None and is_due:
            self._describe()

    def _take(self, now: Description) -> None:
        self._topics, self._silent = now.topics, now.silent
        shown = {name: topic for name, topic in self._topics.items() if not hidden(name)}
        for name in [n for n, old in self._shown.items() if n not in shown or _differ(old.topic, shown[n])]:
            self._leave(name)
            self._shown.pop(name).channel.close()
        for name, topic in shown.items():
            if name in self._shown:
                self._shown[name] = self._shown[name]._replace(topic=topic)
            else:
                self._offer(topic)
        log = [topic for topic in self._topics.values() if log_entries.is_logged(topic.type_hash)]
        self._read(log, 0.0)
        for topic in log:
            for frame in self._history(topic):
                self._note(frame, topic)
        known = {name: old for name, old in self._services.items() if old.node in now.silent}
        self._offer_services(known | now.services)
        self._server.publish_connection_graph(self._connections(now.infos))
        params = {node: info["params"] for node, info in now.infos.replies.items()}
        self._server.publish_parameter_values(as_parameters(full_names(params)))

    def _offer(self, topic: Topic) -> None:
        schema = foxglove.Schema(
            name=topic.type or "Value", encoding="jsonschema", data=schema_text(topic.json_schema)
        )
        channel = foxglove.Channel(topic.name, schema=schema, message_encoding="json", context=self._context)
        self._shown[topic.name] = _Shown(topic, channel, to_json(topic.json_schema))

    def _offer_services(self, services: dict[str, ServiceType]) -> None:
        gone = [name for name, service in self._services.items() if services.get(name) != service]
        new = [service for name, service in services.items() if self._services.get(name) != service]
        self._server.remove_services(gone)
        self._server.add_services([self._service(service) for service in new])
        self._services = services

    def _service(self, service: ServiceType) -> foxglove.Service:
        def described(name: str, schema: dict[str, Any]) -> foxglove.MessageSchema:
            described_as = foxglove.Schema(name=name, encoding="jsonschema", data=schema_text(schema))
            return foxglove.MessageSchema(encoding="json", schema=described_as)

        return foxglove.Service(
            service.name,
            schema=foxglove.ServiceSchema(
                service.request_name.removesuffix("Request"),
                request=described(service.request_name, service.request),
                response=described(service.reply_name, service.reply),
            ),
            handler=lambda asked: self._access.call(service, asked.payload),
        )

    def _connections(self, infos: Answers) -> foxglove.ConnectionGraph:
        graph = foxglove.ConnectionGraph()
        for name, shown in self._shown.items():
            graph.set_published_topic(name, [f"/{shown.topic.node}"])
        readers: dict[str, list[str]] = {}
        for edge in infos.edges():
            readers.setdefault(edge.topic, []).append(f"/{edge.node}")
        for topic, nodes in readers.items():
            graph.set_subscribed_topic(topic, nodes)
        for service in self._services.values():
            graph.set_advertised_service(service.name, [f"/{service.node}"])
        return graph


def _differ(old: Topic, new: Topic) -> bool:
    return (old.type_hash, json_form(old.json_schema)) != (new.type_hash, json_form(new.json_schema))
