"""A YAML file as a tree in which every key and value knows its line and column.

Plain scalars are read by YAML 1.2's core rules: only ``true`` and ``false`` are booleans (``on`` and ``no``
are text) and ``1e-3`` is a number. A key that is given twice is an error.

Whatever the text, reading it takes little time and memory: size, depth and the number of values are bounded,
those that an alias repeats among them.
"""

from __future__ import annotations

import errno
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import yaml
from yaml.composer import Composer

from palp_core.graph.problems import GraphProblems, Mark, Problem, Problems
from palp_core.whole_file import read_whole, why_not

Plain: TypeAlias = str | int | float | bool | None

LARGEST_BYTES = 256 * 1024
DEEPEST = 50
MOST_VALUES = 10_000
INT_BITS = 64
"""What a file may hold: its size, how far values nest, how many there are, and what a whole number takes."""

_TOO_WIDE = f"a whole number has at most {INT_BITS} bits"
_LONGEST_NUMBER = 1000
_TEXT_AS_VALUES = 64  # so many letters count for one value more: an alias may repeat a long text


class _Unknown:
    """In place of a value whose mistake has been reported already."""

    def __repr__(self) -> str:
        return "UNKNOWN"


UNKNOWN: Final[Any] = _Unknown()


@dataclass(frozen=True, slots=True)
class Scalar:
    """A single value."""

    mark: Mark
    value: Plain
    text: str  # as written, without quotes
    quoted: bool = False


@dataclass(frozen=True, slots=True)
class Entry:
    """A value in a mapping, with the place of its key."""

    mark: Mark
    value: Tree


@dataclass(frozen=True, slots=True)
class Mapping:
    """Keys and values, in the file's order."""

    mark: Mark
    items: dict[str, Entry]


@dataclass(frozen=True, slots=True)
class Sequence:
    mark: Mark
    items: tuple[Tree, ...]


Tree: TypeAlias = Scalar | Mapping | Sequence

_TAG = "tag:yaml.org,2002:"


class _TooMuch(yaml.YAMLError):
    """The text is YAML, and no graph is described like that; the event is where it becomes too much."""

    def __init__(self, message: str, event: Any) -> None:
        super().__init__(message)
        self.line, self.column = event.start_mark.line + 1, event.start_mark.column + 1


class _Loader(Composer, yaml.CSafeLoader):
    """libyaml's parser, PyYAML's composer, the scalar rules of YAML 1.2's core schema, and bounds."""

    yaml_implicit_resolvers = {}

    def __init__(self, text: str) -> None:
        Composer.__init__(self)
        try:
            yaml.CSafeLoader.__init__(self, text)
        except UnicodeEncodeError as error:  # half of a pair, as an argument that is not UTF-8 has them
            at = len(text[: error.start].encode())
            raise yaml.reader.ReaderError("", at, ord(text[error.start]), "utf-8", error.reason) from error
        self._depth = self._count = 0
        self._counts: dict[int, int] = {}  # of what an alias may repeat, by the node's id

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Compose a value unless it is one too many, or too deep."""
        event = self.peek_event()
        before = self._count
        if isinstance(event, yaml.AliasEvent):
            node = super().compose_node(parent, index)
            self._add(self._counts.get(id(node), 1), event)
            return node
        self._depth += 1
        if self._depth > DEEPEST:
            raise _TooMuch(f"more than {DEEPEST} values lie in each other", event)
        self._add(1 + len(getattr(event, "value", "")) // _TEXT_AS_VALUES, event)
        node = super().compose_node(parent, index)
        self._depth -= 1
        self._counts[id(node)] = self._count - before
        return node

    def _add(self, count: int, event: yaml.Event | None) -> None:
        self._count += count
        if self._count > MOST_VALUES:
            raise _TooMuch(f"more than {MOST_VALUES} values, those that an alias repeats among them", event)


for _name, _pattern, _first in (
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("int", r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", "-+0123456789"),
    (
        "float",
        r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
        "-+.0123456789",
    ),
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
):
    _Loader.add_implicit_resolver(_TAG + _name, re.compile(f"(?:{_pattern})\\Z"), list(_first))


def _plain(tag: str, text: str) -> Plain:
    match tag.removeprefix(_TAG):
        case "str":
            return text
        case "int":
            if len(text) > _LONGEST_NUMBER:
                raise ValueError(_TOO_WIDE)
            return int(text, 0) if text[:2] in ("0o", "0x") else int(text)
        case "float":
            return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        case "bool":
            return text.lower() == "true"
        case "null":
            return None
    raise ValueError(f"the tag {tag} has no meaning here")


def _in_bounds(value: Plain) -> Plain:
    """Return a value that every part of a graph can take: messages carry whole numbers of 64 bits."""
    if isinstance(value, int) and not -(1 << INT_BITS - 1) <= value < 1 << INT_BITS:
        raise ValueError(_TOO_WIDE)
    return value


class _Converter:
    def __init__(self, file: str, problems: Problems) -> None:
        self.file = file
        self.problems = problems
        self._open: set[int] = set()

    def mark(self, node: yaml.Node) -> Mark:
        return Mark(self.file, node.start_mark.line + 1, node.start_mark.column + 1)

    def convert(self, node: yaml.Node) -> Tree:
        mark = self.mark(node)
        if id(node) in self._open:
            self.problems.add(mark, "an alias refers to itself; write the value out")
            return Scalar(mark, UNKNOWN, "")
        self._open.add(id(node))
        try:
            if isinstance(node, yaml.MappingNode):
                return self._mapping(node, mark)
            if isinstance(node, yaml.SequenceNode):
                return Sequence(mark, tuple(self.convert(item) for item in node.value))
            return self._scalar(node, mark)
        finally:
            self._open.discard(id(node))

    def _scalar(self, node: yaml.Node, mark: Mark) -> Scalar:
        quoted = bool(getattr(node, "style", ""))
        try:
            value = _plain(node.tag, node.value)
            return Scalar(mark, _in_bounds(value), node.value, quoted)
        except ValueError as error:
            self.problems.add(mark, f"'{shortened(node.value)}' cannot be read: {error}")
            return Scalar(mark, UNKNOWN, node.value, quoted)

    def _mapping(self, node: yaml.MappingNode, mark: Mark) -> Mapping:
        items: dict[str, Entry] = {}
        for key, value in node.value:
            place = self.mark(key)
            if not isinstance(key, yaml.ScalarNode):
                self.problems.add(
                    place, "a key must be a single word; put the list or mapping on the value's side"
                )
            elif key.value == "<<" and not key.style:
                self.problems.add(
                    place, "merge keys (<<) are not read: YAML 1.2 has none; write its keys out"
                )
            elif key.value in items:
                first = items[key.value].mark
                self.problems.add(
                    place, f"key '{key.value}' is given twice (first at line {first.line}); remove one"
                )
            else:
                items[key.value] = Entry(place, self.convert(value))
        return Mapping(mark, items)


def read_tree(path: Path, problems: Problems) -> Tree:
    """Read a YAML file; duplicate keys are added to ``problems``, the first of them counts."""
    file = str(path)
    try:
        text = read_whole(path, LARGEST_BYTES).decode()
    except OSError as error:
        advice = "is this the launch file?" if error.errno == errno.EFBIG else "check the path"
        raise _mistake(file, f"cannot be read: {why_not(error, path)}; {advice}") from error
    except UnicodeDecodeError as error:
        raise _mistake(file, "is not UTF-8 text; save it as UTF-8") from error
    tree = parse_tree(text, file, problems)
    if tree is None:
        raise _mistake(file, "is empty; is this the file?")
    return tree


def _mistake(file: str, message: str, line: int = 1, column: int = 1) -> GraphProblems:
    return GraphProblems([Problem(file, line, column, message)])


def parse_tree(text: str, file: str, problems: Problems) -> Tree | None:
    """Read YAML from a text that came from ``file``, as :func:`read_tree`; None if there is nothing in it."""
    try:
        root = _Loader(text).get_single_node()
    except yaml.reader.ReaderError as error:
        before = text.encode(errors="surrogatepass")[: error.position].decode()
        column = len(before) - before.rfind("\n")
        message = f"character {chr(error.character)!r} is not allowed in YAML; remove it"
        raise _mistake(file, message, before.count("\n") + 1, column) from error
    except _TooMuch as error:
        raise _mistake(file, f"{error}; describe less in one file", error.line, error.column) from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line, column = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        message = f"not valid YAML: {error.problem or error}"
        if error.context and error.context_mark:
            message += f", {error.context} (line {error.context_mark.line + 1})"
        raise _mistake(file, f"{message}; check indentation, quotes, colons", line, column) from error
    return None if root is None else _Converter(file, problems).convert(root)


def plain_tree(tree: Tree) -> Plain | list[Any] | dict[str, Any]:
    """Return a tree as Python's own values, without their places."""
    if isinstance(tree, Mapping):
        return {name: plain_tree(entry.value) for name, entry in tree.items.items()}
    if isinstance(tree, Sequence):
        return [plain_tree(item) for item in tree.items]
    return tree.value


def shortened(text: str) -> str:
    """Return a text of any length as a message can show it.

    >>> shortened("short"), len(shortened("long" * 1000))
    ('short', 60)
    """
    return text if len(text) <= 60 else f"{text[:57]}..."


def parse_scalar(text: str) -> Plain:
    r"""Return what YAML reads a text as; what is not a single YAML value stays text.

    >>> [parse_scalar(text) for text in ("1e-3", "on", "'5'", "a: b", "\udcff")]
    [0.001, 'on', '5', 'a: b', '\udcff']
    """
    try:
        node = _Loader(text).get_single_node()
        return _in_bounds(_plain(node.tag, node.value)) if isinstance(node, yaml.ScalarNode) else text
    except (yaml.YAMLError, ValueError):
        return text
