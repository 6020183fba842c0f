"""What others are told of a message class."""

from __future__ import annotations

from typing import Any

import msgspec

from palp_core.graph.messages.message import Message
from palp_core.graph.messages.schema import json_schema, schema_of
from palp_core.graph.messages.schema_reader import ros_text


class MessageType(msgspec.Struct, frozen=True):
    """A message type: its name, hash (16 hexadecimal digits), ROS text and JSON Schema."""

    name: str
    type_hash: str
    ros_text: str
    json_schema: dict[str, Any]

    @classmethod
    def of(cls, message: type[Message]) -> MessageType:
        """Return what others are told of a message class."""
        schema = schema_of(message)
        described = json_schema(schema)
        return cls(schema.name, schema.hash_text, ros_text(described), described)
