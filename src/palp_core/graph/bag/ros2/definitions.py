"""What ROS 2's message types are made of: standard ones by name, others by their ``.msg`` text."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from palp_core.errors import BagError
from palp_core.foreign import catch_foreign
from palp_core.graph.messages.schema_reader import FLOAT64_DTYPE

ROS2_KEY = "x-ros2"
"""In the JSON Schema of a message that came from ROS 2: its ``type``, ``definition`` and ``qos`` there."""

DEEPEST, MOST_FIELDS, LONGEST_ARRAY = 32, 1 << 14, 1 << 24
"""Bounds of a message type (assumed): how deep it is nested, fields with those of its parts, fixed arrays."""

_FILLER = "structure_needs_at_least_one_member"  # rosbags adds it to a message without fields
PACKED = frozenset({"float32", "float64"})
BYTES = frozenset({"uint8", "byte", "octet", "char"})
_SCALARS = {"string": "string", "bool": "boolean"} | dict.fromkeys(("float128", *PACKED), "number")


class FieldType(NamedTuple):
    base: str  # ``float64``, ``string`` or a message's full name, ``geometry_msgs/msg/Wrench``
    is_message: bool
    many: bool = False
    length: int = 0  # how many, where that is fixed

    def __str__(self) -> str:
        return self.base + (f"[{self.length or ''}]" if self.many else "")

    @property
    def dtype(self) -> np.dtype[Any]:
        names = dict.fromkeys(BYTES, "uint8") | {"float128": "longdouble"}
        return np.dtype(names.get(self.base, self.base))


class Definitions:
    """Message types by their full names, with what reads and writes their bytes (CDR)."""

    def __init__(self, store: Any) -> None:
        self.store = store
        self._fields: dict[str, dict[str, FieldType]] = {}
        self._field_counts: dict[str, int] = {}
        self._classes: dict[str, type] = {}

    def __contains__(self, name: str) -> bool:
        return name in self.store.fielddefs

    @property
    def names(self) -> list[str]:
        return sorted(self.store.fielddefs)

    def fields(self, name: str) -> dict[str, FieldType]:
        """Return the fields of a message type by name, in order."""
        self._count_fields(name, ())
        return self._fields[name]

    def _count_fields(self, name: str, within: tuple[str, ...]) -> int:
        if name in self._field_counts:
            return self._field_counts[name]
        if name in within or len(within) >= DEEPEST:
            what = "itself" if name in within else f"messages more than {DEEPEST} deep"
            raise BagError(f"{(*within, name)[0]} holds {what}; palp reads no such type")
        found = field_types(self.store.fielddefs[name][1])
        count = 0
        for field, kind in found.items():
            if kind.length > LONGEST_ARRAY:
                raise BagError(f"{name}: {field}: palp reads no {kind}")
            count += self._count_fields(kind.base, (*within, name)) if kind.is_message else 1
        if count > MOST_FIELDS:
            raise BagError(f"{name} has {count} fields, its parts' included; palp reads {MOST_FIELDS}")
        self._fields[name], self._field_counts[name] = found, count
        return count

    def message_class(self, name: str) -> Any:
        """Return the dataclass of a message type; a field that is not given is zero or empty."""
        if name not in self._classes:
            self._classes[name] = dataclasses.make_dataclass(
                name.rpartition("/")[2],
                [
                    (attribute(field), Any, dataclasses.field(default_factory=self._zero(kind)))
                    for field, kind in self.fields(name).items()
                ],
                bases=(self.store.types[name],),
                eq=False,
            )
        return self._classes[name]

    def _zero(self, kind: FieldType) -> Callable[[], Any]:
        if kind.is_message:
            inner: Callable[[], Any] = self.message_class(kind.base)
            return (lambda: [inner() for _ in range(kind.length)]) if kind.many else inner
        if kind.base == "string":
            return (lambda: [""] * kind.length) if kind.many else str
        return (lambda: np.zeros(kind.length, kind.dtype)) if kind.many else kind.dtype.type(0).item

    def add(self, texts: Mapping[str, str]) -> None:
        """Add message types: their ``.msg`` texts, perhaps with those that they need, by full name."""
        from rosbags.typesys import get_types_from_msg

        found: dict[str, Any] = {}
        for name, text in texts.items():
            with catch_foreign(f"{name}: its definition cannot be read", BagError):
                found |= get_types_from_msg(text, name)
        self.take(found)

    def take(self, found: Mapping[str, Any]) -> None:
        """Add message types as rosbags reads them."""
        new = {name: described for name, described in found.items() if name not in self}
        for name, described in found.items():
            both = self.store.fielddefs.get(name, described), described
            known, given = ([field for field in one[1] if field[0] != _FILLER] for one in both)
            if known != given:
                raise BagError(f"two different messages are called {name}")
        with catch_foreign("a message's definition cannot be taken", BagError):
            self.store.register(new)

    def text(self, name: str) -> str:
        """Return the ``.msg`` text of a type and of all that it needs, as ROS 2's bags have it."""
        found: str = self.store.generate_msgdef(name, ros_version=2)[0]
        return found


def empty() -> Definitions:
    return Definitions(_store("EMPTY"))


def standard() -> Definitions:
    """Return those that come with ROS 2: std_msgs, sensor_msgs, geometry_msgs, tf2_msgs and others."""
    return Definitions(_store("LATEST"))


def _store(which: str) -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores[which])


def field_types(described: Iterable[tuple[str, Any]]) -> dict[str, FieldType]:
    """Return the types of fields, by name, as rosbags describes them."""
    return {field: _field_type(kind) for field, kind in described}


def _field_type(described: Any) -> FieldType:
    kind, inner = described
    if kind.name == "NAME":
        return FieldType(inner, True)
    if kind.name == "BASE":
        return FieldType(inner[0], False)
    length = inner[1] if kind.name == "ARRAY" else 0
    return _field_type(inner[0])._replace(many=True, length=length)


@functools.cache
def attribute(name: str) -> str:
    """Return the attribute of a dataclass that has a field: Python's own words get an underscore."""
    from rosbags.typesys.base import normalize_fieldname

    return str(normalize_fieldname(name))


def json_schema(definitions: Definitions, name: str) -> dict[str, Any]:
    """Return the JSON Schema of a message type, as palp describes its own."""
    properties = {field: _schema(definitions, kind) for field, kind in definitions.fields(name).items()}
    return {
        "title": name.rpartition("/")[2],
        "type": "object",
        "properties": properties,
        "required": list(properties),
    }


def _schema(definitions: Definitions, kind: FieldType) -> dict[str, Any]:
    if kind.many and kind.base in BYTES:
        return {"type": "string", "contentEncoding": "base64"}
    if kind.many and kind.base in PACKED:
        return {"type": "string", "contentEncoding": "base64", "x-dtype": FLOAT64_DTYPE}
    if kind.many:
        return {"type": "array", "items": _schema(definitions, kind._replace(many=False))}
    if kind.is_message:
        return json_schema(definitions, kind.base)
    return {"type": _SCALARS.get(kind.base, "integer")}
