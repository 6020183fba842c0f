"""Messages as JSON, by schema alone, as a bag of JSON has them: one layout shows both."""

import json
from collections.abc import Callable
from typing import Any

import msgspec

from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.bag.forms import json_form
from palp_core.graph.discovery.message_yaml import packed
from palp_core.graph.messages.schema_reader import JsonSchema
from palp_core.graph.messages.schema_types import payload_decoder, plain
from palp_core.graph.messages.topic import ANY_SCHEMA

MOST_BYTES = 1 << 20
"""Of what a viewer sends."""


def schema_text(schema: dict[str, Any]) -> bytes:
    """Return the JSON Schema of a message as JSON: its arrays are lists of numbers."""
    return json.dumps(json_form(schema)).encode()


def to_json(schema: JsonSchema) -> Callable[[bytes | memoryview], bytes]:
    """Return a function from a payload to JSON; what JSON cannot say, NaN and infinity, becomes null.

    It raises SchemaMismatch if a payload is not what the schema says.
    """
    try:
        decode = payload_decoder(schema, "Value")
    except SchemaMismatch:  # another tool's schema, which has what no message can have: shown as it comes
        decode = payload_decoder(ANY_SCHEMA, "Value")

    def convert(payload: bytes | memoryview) -> bytes:
        try:
            return msgspec.json.encode(plain(decode(payload)))
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise SchemaMismatch(f"not what its schema says: {error}") from error

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
        raise GraphError(f"no {title}: {error}") from error
    return message
