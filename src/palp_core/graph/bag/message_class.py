"""Message classes from the schemas in a bag, so that a graph takes what a bag holds for what a node sent.

The class has the recorded type's name, fields and units, hence its type hash: to a reader's check it is the
recorded type. Bounds are not in a schema; the readers' own types check them. Progress is the runtime's own,
which the launch view knows.
"""

import types
from typing import Annotated, Any, get_args, get_origin

from msgspec import Meta

from palp_core.errors import BagError, SchemaMismatch
from palp_core.graph.bag.stream import MESSAGE_ENCODING
from palp_core.graph.bag.values import type_from_schema
from palp_core.graph.messages.builtin import Progress
from palp_core.graph.messages.message import Message
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.messages.schema_reader import JsonSchema, fields_of, unit_of
from palp_core.graph.messages.topic import Topic


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
        made = type_from_schema(topic.json_schema, topic.type, _class)
        type_hash = schema_of(made).hash_text
    except (BagError, TypeError, SchemaMismatch) as error:
        raise BagError(f"{where}: its schema is not a palp message's: {error}") from error
    if topic.type_hash not in ("", type_hash):
        raise BagError(
            f"{where}: its schema makes a {topic.type} of type hash {type_hash}, recorded was "
            f"{topic.type_hash}: the bag was written by another version or its schema was changed"
        )
    return Progress if type_hash == schema_of(Progress).hash_text else made


def _class(schema: JsonSchema, name: str, fields: dict[str, Any]) -> type[Message]:
    units = {field: unit_of(entry) for field, entry in fields_of(schema).items()}
    body = {
        "__annotations__": {field: _with_unit(kind, units[field]) for field, kind in fields.items()},
        "__module__": __name__,
        "__doc__": schema.get("description", ""),
    }
    made: type[Message] = types.new_class(
        name, (Message,), exec_body=lambda namespace: namespace.update(body)
    )
    return made


def _with_unit(kind: Any, unit: str) -> Any:
    """Return a field's type with its unit, which a list's elements have."""
    if not unit:
        return kind
    with_unit = Meta(extra_json_schema={"x-unit": unit})
    if get_origin(kind) is list:
        return list[Annotated[get_args(kind)[0], with_unit]]  # type: ignore[misc]
    return Annotated[kind, with_unit]
