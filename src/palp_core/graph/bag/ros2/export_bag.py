"""Turn a bag into a ROS 2 bag (cdr in MCAP) through ``rosbags``.

A topic that came from ROS 2 becomes what it was there. The type of another is derived from its schema, unless
outlets convert it to one of ROS 2's types.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from palp_core.errors import BagError, SchemaMismatch
from palp_core.graph.bag.reader import Bag
from palp_core.graph.bag.ros2.definitions import ROS2_KEY, Definitions, empty
from palp_core.graph.bag.ros2.values import writer as cdr_writer
from palp_core.graph.bag.stream import MESSAGE_ENCODING, Stream
from palp_core.graph.messages import schema_reader
from palp_core.graph.messages.topic import Topic

PACKAGE = "palp_msgs"
_FIELD_NAME = re.compile(r"[a-z](?:_?[a-z0-9]+)*")


class Outlet(NamedTuple):
    """A topic of the ROS 2 bag that is made of one of palp's.

    ``convert`` takes a payload and its log time and returns the messages that it becomes, each after its log
    time: maps or dataclasses.
    """

    topic: str
    type: str
    convert: Callable[[bytes, int], Iterable[tuple[int, Any]]]
    qos: Sequence[Any] = ()  # what its publisher offers, by rosbags' names


OutletsOf = Callable[[Topic], Sequence[Outlet]]


class _Way(NamedTuple):
    connection: Any
    outlet: Outlet
    encode: Callable[[Any], bytes]


def message_texts(schema: schema_reader.JsonSchema) -> dict[str, str]:
    """Return the ``.msg`` text of a message and of all within it, by type name; units are comments."""
    texts: dict[str, str] = {}
    for one in (*schema_reader.nested(schema), schema):
        name = _type_name(one)
        for field in schema_reader.fields_of(one):
            if not _FIELD_NAME.fullmatch(field):
                raise BagError(f"{name}.{field}: ROS field names are lower case, without doubled underscores")
        try:
            text = schema_reader.ros_text(one, lambda inner: _full(_type_name(inner)))
        except SchemaMismatch as error:
            raise BagError(f"{name}.{error}") from error
        if texts.setdefault(name, text) != text:
            raise BagError(f"{_type_name(schema)}: two different messages are called {name}")
    return texts


def write(
    bag: str | Path,
    out: str | Path,
    outlets: OutletsOf | None = None,
    definitions: Definitions | None = None,
) -> int:
    """Write a ROS 2 bag, version 9, that ``ros2 bag`` and ``rosbags`` read.

    Times are those of the graph's clock.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer

    with (
        Bag(bag).whole() as opened,
        Writer(Path(out), version=9, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        return _copy(opened, writer, definitions or empty(), outlets)


def _copy(bag: Bag, writer: Any, definitions: Definitions, outlets: OutletsOf | None) -> int:
    connections: dict[tuple[str, str], Any] = {}
    ways: dict[int, list[_Way]] = {}
    count = 0
    for stream, _, log_ns, _, payload in bag.recorded():
        if (found := ways.get(id(stream))) is None:
            chosen = [_same(stream, definitions)] if outlets is None else outlets(stream.topic)
            found = ways[id(stream)] = [_way(one, writer, definitions, connections) for one in chosen]
        for way in found:
            for at_ns, message in way.outlet.convert(payload, log_ns):
                try:
                    data = way.encode(message)
                except BagError as error:
                    raise BagError(f"{stream.topic.name} at {log_ns} ns: {error}") from error
                writer.write(way.connection, at_ns, data)
                count += 1
    return count


def _way(
    outlet: Outlet, writer: Any, definitions: Definitions, connections: dict[tuple[str, str], Any]
) -> _Way:
    key = (outlet.topic, outlet.type)
    if key not in connections:
        connections[key] = writer.add_connection(
            *key, typestore=definitions.store, offered_qos_profiles=outlet.qos
        )
    return _Way(connections[key], outlet, cdr_writer(definitions, outlet.type))


def _same(stream: Stream, definitions: Definitions) -> Outlet:
    """Return the outlet of a topic that goes as it is."""
    topic, schema = stream.topic, stream.topic.json_schema
    if stream.encoding != MESSAGE_ENCODING or not schema_reader.fields_of(schema):
        raise BagError(
            f"{topic.name}: without a schema it cannot become a ROS message; "
            "leave it out with `palp bag filter -x`"
        )
    try:
        origin = schema.get(ROS2_KEY)
        if origin is None:
            definitions.add({_full(name): text for name, text in message_texts(schema).items()})
            return Outlet(topic.name, _full(_type_name(schema)), _unchanged)
        definitions.add({origin["type"]: origin["definition"]})
        return Outlet(topic.name, origin["type"], _unchanged, _profiles(origin.get("qos", [])))
    except BagError as error:
        raise BagError(f"{topic.name}: {error}; filter one out") from error
    except (KeyError, TypeError, AttributeError) as error:
        raise BagError(f"{topic.name}: its ROS 2 definition cannot be read: {error!r}") from error


def _unchanged(payload: bytes, log_ns: int) -> Iterable[tuple[int, Any]]:
    return ((log_ns, msgspec.msgpack.decode(payload)),)


def _profiles(described: list[dict[str, Any]]) -> list[Any]:
    """Return rosbags' profiles of quality of service from their plain values."""
    from rosbags import interfaces

    def one(name: str, value: Any) -> Any:
        kind = getattr(interfaces, f"Qos{name.capitalize()}", None)
        if kind is not None:
            return kind[value]
        return interfaces.QosTime(*value) if isinstance(value, list) else value

    return [
        interfaces.Qos(**{name: one(name, value) for name, value in profile.items()}) for profile in described
    ]


def _full(name: str) -> str:
    return f"{PACKAGE}/msg/{name}"


def _type_name(schema: schema_reader.JsonSchema) -> str:
    name = re.sub(r"[^A-Za-z0-9]", "", str(schema.get("title", "")))
    if not name:
        raise BagError("a schema without a title cannot become a ROS message")
    return name[0].upper() + name[1:]
