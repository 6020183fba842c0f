"""Turn a bag into a ROS 2 bag (cdr in MCAP) through ``rosbags``; ``.msg`` text derives from the schema."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from palp_core.errors import BagError, SchemaMismatch
from palp_core.graph.bag.reader import Bag
from palp_core.graph.bag.stream import MESSAGE_ENCODING, Stream
from palp_core.graph.bag.values import decoder_for
from palp_core.graph.messages import schema_reader

PACKAGE = "palp_msgs"
_FIELD_NAME = re.compile(r"[a-z](?:_?[a-z0-9]+)*")
_NUMBERS: dict[schema_reader.FieldKind, Any] = {
    schema_reader.FieldKind.BOOL: np.bool_,
    schema_reader.FieldKind.INT: np.int64,
    schema_reader.FieldKind.FLOAT: np.float64,
}


def message_texts(schema: schema_reader.JsonSchema) -> dict[str, str]:
    """Return the ``.msg`` text of a message and of all within it, by type name; units are comments.

    Raises:
        BagError: The schema says what a ``.msg`` cannot.
    """
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


def write(bag: str | Path, out: str | Path) -> int:
    """Write a ROS 2 bag, version 9, that ``ros2 bag`` and ``rosbags`` read.

    Times are those of the graph's clock. Needs ``rosbags``.

    Returns:
        How many messages there are.

    Raises:
        BagError: rosbags is not installed, no such bag, the new one exists, two message types share a name,
            or a topic has no schema.
        BagDamaged: The bag is damaged.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise BagError("ROS 2 bags need rosbags: pip install rosbags") from error
    if Path(out).exists():
        raise BagError(f"{out} exists already: choose another name")
    try:
        with (
            Bag(bag) as opened,
            Writer(Path(out), version=9, storage_plugin=StoragePlugin.MCAP) as writer,
        ):
            return _copy(opened, writer, get_typestore(Stores.EMPTY), get_types_from_msg)
    except BagError:
        shutil.rmtree(out, ignore_errors=True)  # half a bag helps nobody
        raise


def _copy(bag: Bag, writer: Any, store: Any, types_from_text: Callable[[str, str], Any]) -> int:
    """Write a bag's messages through rosbags; return how many."""
    texts: dict[str, str] = {}
    connections: dict[tuple[str, str], Any] = {}
    ways: dict[int, tuple[Stream, Any, str, Callable[[bytes], Any]]] = {}
    count = 0
    for stream, _, log_ns, _, payload in bag.recorded():
        way = ways.get(id(stream))
        if way is None:
            topic, schema = stream.topic, stream.topic.json_schema
            if stream.encoding != MESSAGE_ENCODING or not schema_reader.fields_of(schema):
                raise BagError(
                    f"{topic.name}: without a schema it cannot become a ROS message; "
                    "leave it out with `palp bag filter -x`"
                )
            for name, text in message_texts(schema).items():
                if texts.get(name, text) != text:
                    raise BagError(f"{topic.name}: two different messages are called {name}; filter one out")
                if name not in texts:
                    texts[name] = text
                    store.register(types_from_text(text, _full(name)))
            kind = _full(_type_name(schema))
            if (topic.name, kind) not in connections:
                connections[topic.name, kind] = writer.add_connection(topic.name, kind, typestore=store)
            connection = connections[topic.name, kind]
            way = ways[id(stream)] = (stream, connection, kind, decoder_for(stream))
        message = _ros_value(way[2], way[3](payload), way[0].topic.json_schema, store)
        writer.write(way[1], log_ns, store.serialize_cdr(message, way[2]))
        count += 1
    return count


def _full(name: str) -> str:
    return f"{PACKAGE}/msg/{name}"


def _type_name(schema: schema_reader.JsonSchema) -> str:
    name = re.sub(r"[^A-Za-z0-9]", "", str(schema.get("title", "")))
    if not name:
        raise BagError("a schema without a title cannot become a ROS message")
    return name[0].upper() + name[1:]


def _ros_value(type_name: str, value: Any, schema: schema_reader.JsonSchema, store: Any) -> Any:
    fields = {}
    for name, inner in schema_reader.fields_of(schema).items():
        fields[name] = _ros_field(getattr(value, name), inner, store)
    return store.types[type_name](**fields)


def _ros_field(value: Any, schema: schema_reader.JsonSchema, store: Any) -> Any:
    if isinstance(value, bytes):
        return np.frombuffer(value, np.uint8)
    if isinstance(value, msgspec.Struct):
        return _ros_value(_full(_type_name(schema)), value, schema, store)
    if isinstance(value, list):
        items = schema_reader.items_of(schema)
        if (kind := schema_reader.kind_of(items)) in _NUMBERS:
            return np.array(value, _NUMBERS[kind])
        return [_ros_field(item, items, store) for item in value]
    return value
