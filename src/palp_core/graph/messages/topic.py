"""Message types and topics as others know them: tools of a running graph, checks of wires, bags."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

if TYPE_CHECKING:
    from palp_core.graph.messages.message import Message

ANY_SCHEMA: dict[str, Any] = {"type": "object"}


class Topic(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One topic.

    Attributes:
        name: As in ``/torque/block``.
        type: Name of the message type; "" if unknown.
        type_hash: 16 hexadecimal digits; "" if unknown.
        node: Who publishes it in a running graph, and is asked for what was missed.
        publish: Where.
        json_schema: What the message is made of.
        latched_depth: How many last messages a late reader is owed (transient local); each file of a split
            bag begins with them.
    """

    name: str
    type: str = ""
    type_hash: str = ""
    node: str = ""
    publish: str = ""
    json_schema: dict[str, Any] = msgspec.field(default_factory=lambda: dict(ANY_SCHEMA))
    latched_depth: int = 0


def topic_of(
    name: str, message: type[Message], node: str = "", publish: str = "", latched_depth: int = 0
) -> Topic:
    """Return the topic of that name that carries messages of this class."""
    from palp_core.graph.messages.schema import schema_of  # numpy; many tools do without

    schema = schema_of(message)
    return Topic(
        name=name, type=schema.name, type_hash=schema.hash_text, node=node, publish=publish,
        json_schema=schema.json_schema, latched_depth=latched_depth,
    )  # fmt: skip


class MessageType(msgspec.Struct, frozen=True):
    """A message type: its name, hash (16 hexadecimal digits), ROS text and JSON Schema."""

    name: str
    type_hash: str
    ros_text: str
    json_schema: dict[str, Any]

    @classmethod
    def of(cls, message: type[Message]) -> MessageType:
        from palp_core.graph.messages.schema import schema_of  # as above
        from palp_core.graph.messages.schema_reader import ros_text

        schema = schema_of(message)
        return cls(schema.name, schema.hash_text, ros_text(schema.json_schema), schema.json_schema)
