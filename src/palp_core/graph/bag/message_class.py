"""Message classes from the schemas in a bag, so that a graph takes what a bag holds for what a node sent.

The class has the recorded type's name, fields and units, hence its type hash: to a reader's check it is the
recorded type. Bounds are not in a schema; the readers' own types check them. Progress is the runtime's own,
which the launch view knows.
"""

from __future__ import annotations

import types
from collections.abc import Callable
from typing import Annotated, Any

from msgspec import Meta

from palp_core.errors import BagError, SchemaMismatch
from palp_core.graph.bag.topic import MESSAGE_ENCODING, Topic
from palp_core.graph.bag.values import is_array
from palp_core.graph.messages.builtin import Progress
from palp_core.graph.messages.message import Message
from palp_core.graph.messages.schema import schema_of
from palp_core.units import Float64Array

_SCALARS: dict[str, Any] = {"boolean": bool, "integer": int, "number": float, "string": str}


def message_class(topic: Topic, encoding: str = MESSAGE_ENCODING) -> type[Message]:
    """Return a message class like the one whose messages a topic has.

    Args:
        topic: As the bag describes it.
        encoding: Of its messages.

    Raises:
        BagError: The bag does not say what the messages are made of, or the class would not be that type.
    """
    where = f"{topic.name} cannot be played"
    if encoding != MESSAGE_ENCODING or "properties" not in topic.json_schema:
        raise BagError(f"{where}: the bag has no schema of palp's for it; leave the topic out")
    try:
        made = _class(topic.json_schema, topic.type)
        type_hash = f"{schema_of(made).type_hash:016x}"
    except (KeyError, TypeError, SchemaMismatch) as error:
        raise BagError(f"{where}: its schema is not a palp message's: {error}") from error
    if topic.type_hash not in ("", type_hash):
        raise BagError(
            f"{where}: its schema makes a {topic.type} of type hash {type_hash}, recorded was "
            f"{topic.type_hash}: the bag was written by another version or its schema was changed"
        )
    return Progress if type_hash == f"{schema_of(Progress).type_hash:016x}" else made


def _class(schema: dict[str, Any], name: str) -> type[Message]:
    fields = {field: _annotation(entry, f"{name}_{field}") for field, entry in schema["properties"].items()}
    body = {"__annotations__": fields, "__module__": __name__, "__doc__": schema.get("description", "")}
    made: type[Message] = types.new_class(schema.get("title", name), (Message,), exec_body=_into(body))
    return made


def _into(body: dict[str, Any]) -> Callable[[dict[str, Any]], None]:
    """Return the function that fills a new class's namespace."""
    return lambda namespace: namespace.update(body)


def _annotation(schema: dict[str, Any], name: str) -> Any:
    kind = schema["type"]
    if kind == "array":
        return list[_annotation(schema["items"], name)]  # type: ignore[misc]
    if kind == "object":
        return _class(schema, name)
    if is_array(schema):
        found: Any = Float64Array
    elif "contentEncoding" in schema:
        found = bytes
    else:
        found = _SCALARS[kind]
    unit = schema.get("x-unit", "")
    return Annotated[found, Meta(extra_json_schema={"x-unit": unit})] if unit else found
