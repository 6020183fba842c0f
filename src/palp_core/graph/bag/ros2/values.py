"""ROS 2's bytes (CDR) as maps as they travel in palp, and back, through ``rosbags``."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from palp_core.errors import BagError
from palp_core.foreign import describe_foreign
from palp_core.graph.bag.ros2.definitions import BYTES, PACKED, Definitions, FieldType, attribute

FLOAT64 = np.dtype("<f8")


def reader(definitions: Definitions, name: str) -> Callable[[bytes], dict[str, Any]]:
    """Return the function from a message's bytes to its map: arrays of floats are packed as float64.

    It raises BagError if the bytes are not such a message.
    """
    decode, to_map = definitions.store.deserialize_cdr, _map_of(definitions, name)

    def read(data: bytes) -> dict[str, Any]:
        try:
            found: dict[str, Any] = to_map(decode(data, name))
        except Exception as error:  # rosbags decodes by code that it generates, whose errors have no base
            raise BagError(f"no {name}: {describe_foreign(error)}") from error
        return found

    return read


def writer(definitions: Definitions, name: str) -> Callable[[Any], bytes]:
    """Return the function from a map or a dataclass to the message's bytes.

    What a map lacks is zero or empty. It raises BagError if a value does not fit its field.
    """
    encode, to_message = definitions.store.serialize_cdr, _message_of(definitions, name)

    def write(value: Any) -> bytes:
        try:
            return bytes(encode(to_message(value), name))
        except Exception as error:  # as above
            raise BagError(f"no {name}: {describe_foreign(error)}") from error

    return write


def _map_of(definitions: Definitions, name: str) -> Callable[[Any], Any]:
    fields = [
        (field, attribute(field), _plain(definitions, kind))
        for field, kind in definitions.fields(name).items()
    ]
    return lambda message: {field: convert(getattr(message, one)) for field, one, convert in fields}


def _plain(definitions: Definitions, kind: FieldType) -> Callable[[Any], Any]:
    """Return what makes the value of a field plain."""
    if kind.is_message:
        inner = _map_of(definitions, kind.base)
        return (lambda values: [inner(value) for value in values]) if kind.many else inner
    if not kind.many or kind.base == "string":
        return lambda value: value
    if kind.base in BYTES:
        return lambda values: np.asarray(values, np.uint8).tobytes()
    if kind.base in PACKED:
        return lambda values: np.asarray(values, FLOAT64).tobytes()
    return lambda values: np.asarray(values).tolist()


def _message_of(definitions: Definitions, name: str) -> Callable[[Any], Any]:
    base, make = definitions.store.types[name], definitions.message_class(name)
    fields = [
        (field, attribute(field), _of_plain(definitions, kind))
        for field, kind in definitions.fields(name).items()
    ]

    has_arrays = _has_arrays(definitions, name)

    def build(value: Any) -> Any:
        if isinstance(value, Mapping):
            return make(**{one: convert(value[field]) for field, one, convert in fields if field in value})
        if not isinstance(value, base):
            raise TypeError(f"a {type(value).__name__} is no {make.__name__}")
        if not has_arrays:
            return value
        return make(**{one: convert(getattr(value, one)) for _, one, convert in fields})

    return build


def _has_arrays(definitions: Definitions, name: str) -> bool:
    return any(
        kind.many or (kind.is_message and _has_arrays(definitions, kind.base))
        for kind in definitions.fields(name).values()
    )


def _of_plain(definitions: Definitions, kind: FieldType) -> Callable[[Any], Any]:
    """Return what makes the value of a field of a plain one."""
    if kind.is_message:
        inner = _message_of(definitions, kind.base)
        return (lambda values: [inner(value) for value in values]) if kind.many else inner
    if not kind.many or kind.base == "string":
        return lambda value: value
    dtype, of_bytes = kind.dtype, np.uint8 if kind.base in BYTES else FLOAT64

    def array(value: Any) -> Any:
        if isinstance(value, bytes):
            return np.frombuffer(value, of_bytes).astype(dtype)
        return np.asarray(value, dtype)

    return array
