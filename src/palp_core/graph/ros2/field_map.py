"""What becomes of a message's fields on their way: from a map's ``fields`` to a function, all of it checked.

On the left is a field of what the message becomes, on the right where its value comes from: a field of the
message, ``$stamp`` (when it was published), a number or true or false, ``{value: anything}`` for what stands
for itself, ``{from: field, times: 1000.0, plus: 0.0}`` for another unit, or a list of those.

All of a map's fields become one Python expression: a function for each would take most of a message's time on
its way through the bridge.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.description.tree_reader import unknown_keys
from palp_core.graph.description.yaml_tree import UNKNOWN, Scalar, Tree, plain_tree
from palp_core.graph.description.yaml_tree import Mapping as TreeMapping
from palp_core.graph.description.yaml_tree import Sequence as TreeSequence
from palp_core.graph.messages.schema_reader import (
    FieldKind,
    JsonSchema,
    fields_of,
    has_elements,
    is_array,
    items_of,
    kind_of,
)
from palp_core.graph.problems import Mark, Problems
from palp_core.graph.ros2.paths import (
    FLOAT64,
    UNPACK,
    is_number,
    is_time,
    misfit,
    reading,
    schema_at,
    steps,
    words,
)

STAMP = "$stamp"
_STAMP_SCHEMA: dict[str, Any] = {"type": "integer"}
_BILLION = 1_000_000_000
_SOURCE_KEYS = ("value", "from", "times", "plus")

Value = Callable[[Mapping[str, Any], int], Any]
"""From a message, as a map, and when it was published, in ns on the graph's clock."""


class Times(NamedTuple):
    """How the graph's time and ROS 2's go over into each other, both in ns."""

    to_ros: Callable[[int], int] = lambda ns: ns
    to_palp: Callable[[int], int] = lambda ns: ns


class Side(NamedTuple):
    """The two ends of a way.

    Attributes:
        source: Schema of what comes.
        target: Schema of what it becomes.
        times: What becomes of times.
    """

    source: JsonSchema
    target: JsonSchema
    times: Times


class _Side(NamedTuple):
    """A :class:`Side`, and what the expression that is being written knows by name."""

    source: JsonSchema
    target: JsonSchema
    times: Times
    known: dict[str, Any]

    def named(self, value: Any) -> str:
        """Return a name by which the expression has a value."""
        name = f"known_{len(self.known)}"
        self.known[name] = value
        return name


def compile_fields(tree: TreeMapping | None, mark: Mark, side: Side, problems: Problems) -> Value:
    """Return the function that makes the target's map of the source's; mistakes go to ``problems``.

    Args:
        tree: The map's ``fields``; None: fields of the same name.
        mark: Where a mistake of the whole is.
        side: What it is between.
        problems: Takes the mistakes.
    """
    ends = _Side(*side, {UNPACK: _unpacked})
    text = _by_name(mark, ends, problems) if tree is None else _object(tree, ends, problems)
    made: Value = eval(compile(f"lambda message, stamp_ns: {text}", "<fields>", "eval"), ends.known)
    return made


def _by_name(mark: Mark, side: _Side, problems: Problems) -> str:
    known, found = fields_of(side.source), dict[str, str]()
    for name, wanted in fields_of(side.target).items():
        if name not in known:
            continue
        if why := misfit(known[name], wanted):
            problems.add(
                mark, f"field '{name}' is not the same on both sides: {why}; say what it becomes: fields"
            )
        else:
            found[name] = _converted(reading(name, side.source), known[name], wanted, side)
    if not found:
        ours, theirs = side.source.get("title"), side.target.get("title")
        problems.add(mark, f"{ours} and {theirs} have no field in common; say what becomes of what: fields")
    return _made(found)


def _made(found: Mapping[str, str]) -> str:
    return "{" + ", ".join(f"{name!r}: {text}" for name, text in found.items()) + "}"


def _object(tree: TreeMapping, side: _Side, problems: Problems) -> str:
    """Return what makes a message of the paths on the left."""
    branches: dict[str, Any] = {}
    for path, entry in tree.items.items():
        try:
            wanted = schema_at(path, side.target)
            way = steps(path)
        except GraphError as error:
            problems.add(entry.mark, str(error))
            continue
        value = _value(entry.value, side._replace(target=wanted), path, problems)
        if value is not None:
            _put(
                branches,
                [part for step in way for part in step if part is not None],
                value,
                entry.mark,
                problems,
            )
    return _grown(branches, tree.mark, problems)


def _put(branches: dict[str, Any], way: list[str | int], value: str, mark: Mark, problems: Problems) -> None:
    here: dict[Any, Any] = branches
    for part in way[:-1]:
        here = here.setdefault(part, {})
        if not isinstance(here, dict):
            problems.add(mark, "a part of this is given above, as a whole; give one of both")
            return
    if way[-1] in here:
        problems.add(mark, "parts of this are given above; give one of both")
    here[way[-1]] = value


def _grown(branches: dict[Any, Any], mark: Mark, problems: Problems) -> str:
    made = {
        name: _grown(inner, mark, problems) if isinstance(inner, dict) else inner
        for name, inner in branches.items()
    }
    if not made or isinstance(next(iter(made)), str):
        return _made(made)
    if sorted(made) != list(range(len(made))):
        problems.add(mark, f"elements {sorted(made)} are given; count from 0, and leave none out")
    return _listed([made[index] for index in sorted(made)])


def _listed(parts: list[str]) -> str:
    return f"[{', '.join(parts)}]"


def _value(tree: Tree, side: _Side, path: str, problems: Problems) -> str | None:
    """Return the text of what gives a field its value, or None after reporting a mistake."""
    if isinstance(tree, TreeSequence):
        return _list(tree, side, path, problems)
    if isinstance(tree, TreeMapping):
        if not any(key in tree.items for key in _SOURCE_KEYS):
            if kind_of(side.target) is FieldKind.MESSAGE:
                return _object(tree, side, problems)
            problems.add(tree.mark, f"'{path}' is {words(side.target)}; write a field, or {{value: ...}}")
            return None
        return _stated(tree, side, path, problems)
    if tree.value is UNKNOWN:
        return None
    if isinstance(tree.value, str):
        return _from(tree.value, tree.mark, side, path, problems)
    return _constant(tree.value, tree.mark, side, path, problems)


def _list(tree: TreeSequence, side: _Side, path: str, problems: Problems) -> str | None:
    if not has_elements(side.target):
        problems.add(tree.mark, f"'{path}' is {words(side.target)}, not a list")
        return None
    inner = side._replace(target=items_of(side.target))
    parts = [_value(item, inner, f"{path}[{i}]", problems) for i, item in enumerate(tree.items)]
    listed = _listed([part for part in parts if part is not None])
    if not is_array(side.target):
        return listed
    return f"{side.named(_packed)}({listed})"


def _stated(tree: TreeMapping, side: _Side, path: str, problems: Problems) -> str | None:
    """Read ``{value: ...}`` or ``{from: ..., times: ..., plus: ...}``."""
    fields = unknown_keys(tree, _SOURCE_KEYS, f"what '{path}' comes from", problems)
    if "value" in fields:
        if len(fields) > 1:
            problems.add(tree.mark, f"'{path}' has a value and comes from elsewhere; give one of both")
            return None
        return _constant(plain_tree(fields["value"].value), fields["value"].value.mark, side, path, problems)
    origin = fields.get("from")
    if origin is None or not isinstance(origin.value, Scalar) or not isinstance(origin.value.value, str):
        problems.add(
            tree.mark, f"'{path}' does not say where it comes from; write {{from: field, times: 1000.0}}"
        )
        return None
    numbers = {"times": 1.0, "plus": 0.0}
    for name in numbers:
        given = plain_tree(fields[name].value) if name in fields else numbers[name]
        if isinstance(given, bool) or not isinstance(given, int | float):
            problems.add(fields[name].value.mark, f"{name} of '{path}' is '{given}'; it must be a number")
            return None
        numbers[name] = float(given)
    return _scaled(origin.value, numbers["times"], numbers["plus"], side, path, problems)


def _scaled(
    origin: Scalar, times: float, plus: float, side: _Side, path: str, problems: Problems
) -> str | None:
    text, number = str(origin.value), {"type": "number"}
    if (given := _source(text, origin.mark, side, problems)) is None:
        return None
    value, schema = given
    one = items_of(schema) if has_elements(schema) else schema
    if not is_number(one):
        problems.add(origin.mark, f"'{text}' is {words(schema)}; only numbers are multiplied")
        return None
    if one is schema:
        if why := misfit(number, side.target):
            problems.add(origin.mark, f"'{path}': {why}")
            return None
        return f"({value} * {side.named(times)} + {side.named(plus)})"
    if why := misfit({"type": "array", "items": number}, side.target):
        problems.add(origin.mark, f"'{path}': {why}")
        return None
    packed = is_array(side.target)

    def scaled(several: Any) -> Any:
        array = _unpacked(several) * times + plus
        return array.tobytes() if packed else array.tolist()

    return f"{side.named(scaled)}({value})"


def _packed(values: Any) -> bytes:
    return np.asarray(values, FLOAT64).tobytes()


def _unpacked(value: Any) -> Any:
    return np.frombuffer(value, FLOAT64) if isinstance(value, bytes) else np.asarray(value, FLOAT64)


def _source(text: str, mark: Mark, side: _Side, problems: Problems) -> tuple[str, JsonSchema] | None:
    if text == STAMP:
        return "stamp_ns", _STAMP_SCHEMA
    try:
        return reading(text, side.source), schema_at(text, side.source)
    except GraphError as error:
        problems.add(mark, f"{error} (a text that stands for itself is {{value: {text}}})")
        return None


def _from(text: str, mark: Mark, side: _Side, path: str, problems: Problems) -> str | None:
    if (given := _source(text, mark, side, problems)) is None:
        return None
    value, schema = given
    try:
        why = misfit(schema, side.target)
    except SchemaMismatch as error:
        why = str(error)
    if why:
        problems.add(mark, f"'{path}' cannot be '{text}': {why}")
        return None
    return _converted(value, schema, side.target, side)


def _converted(text: str, source: JsonSchema, target: JsonSchema, side: _Side) -> str:
    way = _conversion(source, target, side.times)
    return text if way is None else f"{side.named(way)}({text})"


def _conversion(source: JsonSchema, target: JsonSchema, times: Times) -> Callable[[Any], Any] | None:
    """Return what makes of a value that fits what it must be; None: it is."""
    if is_time(target) and is_time(source):
        return None
    if is_time(target):
        return lambda ns: _time(times.to_ros(ns))
    if is_time(source):
        return lambda time: times.to_palp(time["sec"] * _BILLION + time["nanosec"])
    if is_array(source) and not is_array(target):
        return lambda data: _unpacked(data).tolist()
    if is_array(target) and not is_array(source):
        return _packed
    if has_elements(source) and not is_array(source):
        inner = _conversion(items_of(source), items_of(target), times)
        return inner and (lambda values: [inner(value) for value in values])
    if kind_of(target) is FieldKind.MESSAGE:
        known, wanted = fields_of(source), fields_of(target)
        ways = {name: _conversion(known[name], field, times) for name, field in wanted.items()}
        return lambda value: {n: value[n] if way is None else way(value[n]) for n, way in ways.items()}
    return None


def _time(ns: int) -> dict[str, int]:
    sec, nanosec = divmod(ns, _BILLION)
    return {"sec": sec, "nanosec": nanosec}


def _constant(value: Any, mark: Mark, side: _Side, path: str, problems: Problems) -> str | None:
    """Return a value that is always the same, in the form in which messages travel."""
    from palp_core.graph.discovery.message_yaml import packed

    try:
        constant = packed(value, dict(side.target), path)
    except SchemaMismatch as error:
        problems.add(mark, str(error))
        return None
    return side.named(constant)
