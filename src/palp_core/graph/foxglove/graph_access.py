"""What a viewer asks of a running graph: parameters read and set, services called; in words if refused."""

import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import msgspec

from palp_core.errors import GraphError, SchemaMismatch, in_words
from palp_core.graph.bag.forms import json_form
from palp_core.graph.discovery.message_yaml import packed
from palp_core.graph.discovery.running_graph import Answers, RunningGraph, hidden
from palp_core.graph.messages.schema_reader import JsonSchema
from palp_core.graph.messages.schema_types import payload_decoder, plain
from palp_core.graph.messages.topic import ANY_SCHEMA, Topic
from palp_core.graph.recording.live_feed import is_order, live_topics

ASK_S = 5.0
MOST_BYTES = 1 << 20
"""Of what a viewer sends."""
READ_ONLY = "palp bridge foxglove was started with --read-only"
NOT_OPERATED = "this graph moves something real; start palp bridge foxglove with --operate"


class ServiceType(NamedTuple):
    node: str
    port: str
    request_name: str
    request: dict[str, Any]
    reply_name: str
    reply: dict[str, Any]

    @property
    def name(self) -> str:
        """As in ``/torque/tare``."""
        return f"/{self.node}/{self.port}"


class Description(NamedTuple):
    """A running graph as viewers are offered it."""

    topics: dict[str, Topic]  # all but what nodes consume in which order; hidden ones among them
    services: dict[str, ServiceType]
    infos: Answers
    silent: frozenset[str]  # nodes that did not answer: of those, this lacks a part


def describe(graph: RunningGraph) -> Description:
    """Ask a graph, as its run directory has it now, what it is made of."""
    graph.refresh()
    topics = {name: topic for name, topic in live_topics(graph).items() if not is_order(name)}
    schemas, infos = (graph.ask_all(wanted, timeout_s=ASK_S) for wanted in ("schemas", "info"))
    services = [
        ServiceType(node, port, asked["name"], asked["json_schema"], answer["name"], answer["json_schema"])
        for node, reply in schemas.replies.items()
        for port, described in reply["ports"].items()
        if described["kind"] == "srv"
        for asked, answer in (described["types"],)
    ]
    shown = {service.name: service for service in services if not hidden(service.name)}
    return Description(topics, shown, infos, frozenset({*schemas.silent, *infos.silent}))


class GraphAccess:
    """Asks the nodes of a running graph.

    ``read_only``: nothing may be changed; ``operate``: everything may be, where something real moves, too.
    """

    def __init__(self, graph: RunningGraph, *, read_only: bool, operate: bool) -> None:
        self.graph = graph
        self._read_only, self._operate = read_only, operate

    def refusal(self) -> str:
        """Return why nothing may be changed just now, in words; "" if it may."""
        if self._read_only:
            return READ_ONLY
        return NOT_OPERATED if not self._operate and self.graph.moves_something_real() else ""

    def parameters(self, names: Iterable[str] = ()) -> dict[str, Any]:
        """Return values of parameters, ``/node.parameter``; by default of all. Who is silent is left out."""
        wanted = set(names)
        named = {_split(name)[0] for name in wanted}
        nodes = [node for node in self.graph.node_names if node in named or not wanted]
        answers = self.graph.ask_all("get_parameters", nodes, timeout_s=ASK_S)
        found = full_names({node: reply["parameters"] for node, reply in answers.replies.items()})
        return {name: value for name, value in found.items() if not wanted or name in wanted}

    def set_parameters(self, values: Mapping[str, Any]) -> None:
        """Set parameters; those of one node all or none."""
        self._must_be_allowed("set a parameter")
        by_node: dict[str, dict[str, Any]] = {}
        for name, value in values.items():
            node, parameter = _split(name)
            by_node.setdefault(node, {})[parameter] = value
        refused = []
        for node, changes in by_node.items():
            try:
                self.graph.ask(node, "set_parameters", timeout_s=ASK_S, parameters=changes)
            except GraphError as error:
                refused.append(str(error))
        if refused:
            raise GraphError("; ".join(refused))

    def call(self, service: ServiceType, request: bytes) -> bytes:
        """Call a service, JSON in and out."""
        self._must_be_allowed("call a service")
        message = from_json(request, service.request)
        answer = self.graph.ask(service.node, "call", timeout_s=ASK_S, service=service.port, request=message)
        return to_json(service.reply)(msgspec.msgpack.encode(answer["reply"]))

    def _must_be_allowed(self, what: str) -> None:
        if why := self.refusal():
            raise GraphError(f"refused to {what}: {why}")


def full_names(by_node: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return parameters of several nodes as ``/node.parameter``.

    >>> full_names({"relay": {"gain": 2.0}})
    {'/relay.gain': 2.0}
    """
    return {f"/{node}.{name}": value for node, values in by_node.items() for name, value in values.items()}


def _split(name: str) -> tuple[str, str]:
    node, _, parameter = name.removeprefix("/").partition(".")
    return node, parameter


def schema_text(schema: dict[str, Any]) -> bytes:
    """Return the JSON Schema of a message as JSON: its arrays are lists of numbers."""
    return json.dumps(json_form(schema)).encode()


def to_json(schema: JsonSchema) -> Callable[[bytes | memoryview], bytes]:
    """Return a function from a payload to JSON; NaN and infinity, which JSON lacks, become null.

    It raises SchemaMismatch if a payload does not fit the schema.
    """
    try:
        decode = payload_decoder(schema, "Value")
    except SchemaMismatch:  # another tool's schema, which has what no message can have: shown as it comes
        decode = payload_decoder(ANY_SCHEMA, "Value")

    def convert(payload: bytes | memoryview) -> bytes:
        try:
            return msgspec.json.encode(plain(decode(payload)))
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise SchemaMismatch(f"it does not fit its schema: {in_words(error)}") from error

    return convert


def from_json(text: bytes, schema: dict[str, Any]) -> dict[str, Any]:
    """Return a message as it travels; fields that are not given are left to the receiver's defaults."""
    title = schema.get("title", "message")
    if len(text) > MOST_BYTES:
        raise GraphError(f"no {title}: {len(text)} bytes are more than the {MOST_BYTES} that are read")
    try:
        value = msgspec.json.decode(text or b"{}")
        message: dict[str, Any] = packed(value, schema, "")
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError, SchemaMismatch) as error:
        raise GraphError(f"no {title}: {in_words(error)}") from error
    return message
