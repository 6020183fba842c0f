"""A topic's way over, worked out from a map's entry and what both sides say of the message."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from palp_core.errors import BagError, GraphError, SchemaMismatch
from palp_core.foreign import catch_foreign
from palp_core.graph.bag.forms.ros2 import derived_type
from palp_core.graph.bag.ros2.definitions import Definitions, json_schema
from palp_core.graph.messages.schema_reader import JsonSchema, fields_of, has_elements, is_array, items_of
from palp_core.graph.problems import Problems, hint
from palp_core.graph.ros2.field_map import Side, Times, Value, compile_fields
from palp_core.graph.ros2.map_file import Each, MapEntry
from palp_core.graph.ros2.paths import FLOAT64, is_number, schema_at, words

NS = 1_000_000_000
_SERVICES = {
    "std_srvs/srv/Empty": "---\n",
    "std_srvs/srv/SetBool": "bool data\n---\nbool success\nstring message\n",
    "std_srvs/srv/Trigger": "---\nbool success\nstring message\n",
}
"""What the standard services ask and answer, so that a map of them is checked where no ROS 2 is installed."""


class Crossing(NamedTuple):
    """A topic's way.

    Attributes:
        way: What the map says of it.
        type: Its full name in ROS 2.
        convert: From a message, as a map, and when it was published to what it becomes: times and maps.
    """

    way: MapEntry
    type: str
    convert: Callable[[Mapping[str, Any], int], Iterable[tuple[int, Mapping[str, Any]]]]


def find_definitions(definitions: Definitions, name: str, folders: Sequence[Path]) -> None:
    """Add a message type, with what it needs, from folders with ``PACKAGE/msg/NAME.msg``, if it is not known.

    Folders of ROS 2 installations (``AMENT_PREFIX_PATH``) and of the present Python are looked at, too.

    Raises:
        GraphError: It is nowhere; the nearest known name is in the message.
    """
    wanted = [name]
    texts: dict[str, str] = {}
    while wanted:
        one = wanted.pop()
        if one in definitions or one in texts:
            continue
        text = _text_of(one, folders)
        if text is None:
            needed = "" if one == name else f", which {name} needs,"
            raise GraphError(
                f"no message type '{one}'{needed} is known{hint(one, definitions.names)[:200]}; "
                "others come from the folders of PACKAGE/msg/NAME.msg that interfaces lists"
            )
        texts[one] = text
        wanted += _needed(one, text)
    try:
        definitions.add(texts)
    except BagError as error:
        raise GraphError(str(error)) from error


def find_service(definitions: Definitions, name: str, folders: Sequence[Path]) -> None:
    """Add request and response of a service's type, as :func:`part_of` names them.

    Raises:
        GraphError: Its ``.srv`` is nowhere, or what it needs.
    """
    if part_of(name, "Request") in definitions:
        return
    text = _text_of(name, folders, ".srv") or _SERVICES.get(name)
    if text is None:
        raise GraphError(
            f"no service type '{name}' is known: no {name}.srv is in the folders that interfaces lists, "
            "nor is it installed"
        )
    request, line, response = f"\n{text}\n".partition("\n---")
    if not line:
        raise GraphError(f"{name}.srv has no line --- between request and response")
    for part, said in (("Request", request), ("Response", response.partition("\n")[2])):
        for needed in _needed(part_of(name, part), said):
            find_definitions(definitions, needed, folders)
        definitions.add({part_of(name, part): said})


def part_of(service: str, part: str) -> str:
    """Return what the message of a service's ``Request`` or ``Response`` is called.

    >>> part_of("std_srvs/srv/Trigger", "Request")
    'std_srvs/msg/Trigger_Request'
    """
    return f"{service.replace('/srv/', '/msg/')}_{part}"


def _text_of(name: str, folders: Sequence[Path], ending: str = ".msg") -> str | None:
    import sys

    installed = [
        Path(root) / "share" for root in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if root
    ]
    for folder in (*folders, *installed, Path(sys.prefix) / "share"):
        file = folder / f"{name}{ending}"
        try:
            return file.read_text(encoding="utf-8")
        except FileNotFoundError:
            continue
        except (OSError, UnicodeDecodeError) as error:
            raise GraphError(f"{file} cannot be read: {error}") from error
    return None


def _needed(name: str, text: str) -> list[str]:
    """Return the message types that a ``.msg`` text names."""
    from rosbags.typesys import get_types_from_msg

    from palp_core.graph.bag.ros2.definitions import field_types

    with catch_foreign(f"{name}: its definition cannot be read", GraphError):
        found = get_types_from_msg(text, name)
    return [kind.base for kind in field_types(found[name][1]).values() if kind.is_message]


def crossing_to_ros2(
    way: MapEntry,
    schema: JsonSchema,
    definitions: Definitions,
    folders: Sequence[Path],
    times: Times,
    problems: Problems,
) -> Crossing | None:
    """Return a topic's way to ROS 2, or None after reporting what is wrong.

    Args:
        way: What the map says.
        schema: Of palp's messages.
        definitions: Of ROS 2's; those that are needed are added.
        folders: Where others are.
        times: What becomes of times.
        problems: Takes the mistakes.
    """
    name = _type_of(way, schema, definitions, folders, problems)
    if name is None:
        return None
    before = len(problems)
    each = None if way.each is None else _each(way.each, schema, problems)
    if way.each is not None and each is None:
        return None
    source = schema if way.each is None else _with_one(schema, way.each.over)
    target = json_schema(definitions, name)
    value = compile_fields(way.fields, way.mark, Side(source, target, times), problems)
    if len(problems) > before:
        return None
    if each is not None:
        return Crossing(way, name, lambda message, at_ns: each(value, message, at_ns))
    return Crossing(way, name, lambda message, at_ns: ((at_ns, value(message, at_ns)),))


def crossing_to_palp(
    way: MapEntry,
    schema: JsonSchema,
    definitions: Definitions,
    folders: Sequence[Path],
    times: Times,
    problems: Problems,
) -> Crossing | None:
    """Return a topic's way from ROS 2, or None after reporting what is wrong: as :func:`crossing_to_ros2`."""
    if way.each is not None:
        problems.add(way.each.mark, "each is for what goes to ROS 2")
    name = _type_of(way, schema, definitions, folders, problems)
    if name is None:
        return None
    before = len(problems)
    source = json_schema(definitions, name)
    value = compile_fields(way.fields, way.mark, Side(source, schema, times), problems)
    if len(problems) > before:
        return None
    return Crossing(way, name, lambda message, at_ns: ((at_ns, value(message, at_ns)),))


def _type_of(
    way: MapEntry, schema: JsonSchema, definitions: Definitions, folders: Sequence[Path], problems: Problems
) -> str | None:
    try:
        if not way.type:
            return derived_type(schema, definitions)
        find_definitions(definitions, way.type, folders)
    except (BagError, GraphError) as error:
        problems.add(way.type_mark, str(error))
        return None
    return way.type


def _with_one(schema: JsonSchema, over: str) -> JsonSchema:
    """Return a message's schema with one element in a list's place."""
    known = fields_of(schema)
    return {**schema, "properties": {**known, over: items_of(known[over])}}


_Spread = Callable[[Value, Mapping[str, Any], int], Iterable[tuple[int, Mapping[str, Any]]]]


def _each(each: Each, schema: JsonSchema, problems: Problems) -> _Spread | None:
    """Return what makes a message of each sample of a block."""
    known = fields_of(schema)
    if each.over not in known:
        problems.add(
            each.mark, f"each: {schema.get('title')} has no field '{each.over}'{hint(each.over, known)}"
        )
        return None
    if not has_elements(known[each.over]):
        problems.add(each.mark, f"each: '{each.over}' is {words(known[each.over])}, not several")
        return None
    for name in filter(None, (each.start, each.rate)):
        try:
            number = is_number(schema_at(name, schema))
        except (GraphError, SchemaMismatch) as error:
            problems.add(each.mark, f"each: {error}")
            return None
        if not number:
            problems.add(each.mark, f"each: '{name}' is no number")
            return None
    packed = is_array(known[each.over])

    def spread(
        value: Value, message: Mapping[str, Any], at_ns: int
    ) -> Iterable[tuple[int, Mapping[str, Any]]]:
        samples = message[each.over]
        if packed:
            samples = np.frombuffer(samples, FLOAT64).tolist()
        one = dict(message)
        for index, one[each.over] in enumerate(samples):
            time_ns = at_ns
            if each.start:
                time_ns = message[each.start] + round(index * NS / message[each.rate])
            yield time_ns, value(one, time_ns)

    return spread
