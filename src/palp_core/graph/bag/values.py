"""Messages as objects from the schema in the bag: no message class is needed."""

from __future__ import annotations

import base64
import keyword
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from palp_core.errors import BagError
from palp_core.graph.bag.topic import MESSAGE_ENCODING, Stream
from palp_core.units import Float64Array

FLOAT64 = np.dtype("<f8")
_SCALARS: dict[str, Any] = {"boolean": bool, "integer": int, "number": float, "string": str}


def is_array(schema: dict[str, Any]) -> bool:
    """Say whether a field is a numeric array, which travels as bytes."""
    return schema.get("x-dtype") == FLOAT64.str


def type_from_schema(schema: dict[str, Any], name: str = "Value") -> Any:
    """Return the Python type that a JSON Schema stands for; objects become frozen structs.

    Raises:
        BagError: The schema says what no message can.
    """
    kind = schema.get("type")
    if is_array(schema):
        return Float64Array
    if kind == "string" and "contentEncoding" in schema:
        return bytes
    if kind == "array":
        return list[type_from_schema(schema.get("items", {}), f"{name}Item")]  # type: ignore[misc]
    if kind == "object" and schema.get("properties"):
        names = list(schema["properties"])
        if not all(n.isidentifier() and not keyword.iskeyword(n) for n in names):
            return dict[str, Any]
        fields = [(n, type_from_schema(schema["properties"][n], f"{name}_{n}")) for n in names]
        title = str(schema.get("title", name))
        return msgspec.defstruct(title if title.isidentifier() else name, fields, frozen=True, kw_only=True)
    if kind == "object":
        return dict[str, Any]
    if kind is None:
        return Any
    if kind not in _SCALARS:
        raise BagError(f"a schema's type '{kind}' is not a message's")
    return _SCALARS[kind]


def _from_wire(_: Any, value: Any) -> Any:
    if not isinstance(value, bytes) or len(value) % FLOAT64.itemsize:
        raise ValueError("an array must be msgpack bin with a whole number of float64")
    return np.frombuffer(value, FLOAT64)


def decoder_for(stream: Stream) -> Callable[[bytes], Any]:
    """Return the function that decodes a stream's payloads.

    Structs where the bag has a schema, dicts where it has none, the bytes themselves where neither msgpack
    nor JSON tells what they are.
    """
    if stream.encoding == "json":
        return msgspec.json.decode
    if stream.encoding != MESSAGE_ENCODING:
        return bytes
    kind = type_from_schema(stream.topic.json_schema, stream.topic.type or "Value")
    return msgspec.msgpack.Decoder(kind, dec_hook=_from_wire).decode


def plain(value: Any) -> Any:
    """Return a value as JSON can say it: structs as dicts, arrays as lists, bytes as base64."""
    if isinstance(value, msgspec.Struct):
        return {name: plain(getattr(value, name)) for name in value.__struct_fields__}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value
