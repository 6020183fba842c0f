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

    def read(data: bytes) -> dict[str, Any]:
        try:
            return _map_of(definitions, name, definitions.store.deserialize_cdr(data, name))
        except Exception as error:  # rosbags decodes by code that it generates, whose errors have no base
            raise BagError(f"no {name}: {describe_foreign(error)}") from error

    definitions.fields(name)  # a type beyond bounds is refused before its first message
    return read


def writer(definitions: Definitions, name: str) -> Callable[[Any], bytes]:
    """Return the function from a map or a dataclass to the message's bytes.

    What a map lacks is zero or empty. It raises BagError if a value does not fit its field.
    """
    definitions.message_class(name)

    def write(value: Any) -> bytes:
        try:
            return bytes(definitions.store.serialize_cdr(_message_of(definitions, name, value), name))
        except Exception as error:  # as above
            raise BagError(f"no {name}: {describe_foreign(error)}") from error

    return write


def _map_of(definitions: Definitions, name: str, message: Any) -> dict[str, Any]:
    return {
        field: _plain(definitions, kind, getattr(message, attribute(field)))
        for field, kind in definitions.fields(name).items()
    }


def _plain(definitions: Definitions, kind: FieldType, value: Any) -> Any:
    if kind.is_message and kind.many:
        return [_map_of(definitions, kind.base, one) for one in value]
    if kind.is_message:
        return _map_of(definitions, kind.base, value)
    if not kind.many or kind.base == "string":
        return value
    if kind.base in BYTES or kind.base in PACKED:
        return np.asarray(value, np.uint8 if kind.base in BYTES else FLOAT64).tobytes()
    return np.asarray(value).tolist()


def _message_of(definitions: Definitions, name: str, value: Any) -> Any:
    make, fields = definitions.message_class(name), definitions.fields(name)
    if isinstance(value, Mapping):
        given = {field: value[field] for field in fields if field in value}
    elif isinstance(value, definitions.store.types[name]):
        given = {field: getattr(value, attribute(field)) for field in fields}
    else:
        raise TypeError(f"a {type(value).__name__} is not a {make.__name__}")
    return make(
        **{attribute(field): _of_plain(definitions, fields[field], one) for field, one in given.items()}
    )


def _of_plain(definitions: Definitions, kind: FieldType, value: Any) -> Any:
    if kind.is_message and kind.many:
        return [_message_of(definitions, kind.base, one) for one in value]
    if kind.is_message:
        return _message_of(definitions, kind.base, value)
    if not kind.many or kind.base == "string":
        return value
    if isinstance(value, bytes):
        return np.frombuffer(value, np.uint8 if kind.base in BYTES else FLOAT64).astype(kind.dtype)
    return np.asarray(value, kind.dtype)
