"""Read parts of a YAML tree as the structs that say what may stand there; every mistake has its place."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator
from typing import Any, Literal, TypeVar, get_args, get_origin

import msgspec
from msgspec.structs import FieldInfo

from palp_core.errors import in_words
from palp_core.graph.description.source_file import SourceFile
from palp_core.graph.description.yaml_tree import UNKNOWN, Entry, Tree, shortened
from palp_core.graph.description.yaml_tree import Mapping as TreeMapping
from palp_core.graph.problems import Problems, hint, nearest

Struct = TypeVar("Struct", bound=msgspec.Struct)


@functools.cache
def fields_of(cls: type[msgspec.Struct]) -> dict[str, FieldInfo]:
    """Return the fields of a struct by the key that each is at."""
    return {field.encode_name: field for field in msgspec.structs.fields(cls)}


def flat(value: object) -> str:
    """Return a value as YAML writes it."""
    return str(value).lower() if isinstance(value, bool) else shortened(str(value))


def entries_of(
    cls: type[msgspec.Struct], tree: Tree, what: str, problems: Problems
) -> dict[str, Entry] | None:
    """Return the entries of a mapping whose keys a struct has; None if it is not a mapping.

    An unknown key is reported with the nearest known one, a required one that lacks with an example.
    """
    known = fields_of(cls)
    if not isinstance(tree, TreeMapping):
        problems.add(tree.mark, f"{what} must be a mapping with the keys {', '.join(known)}")
        return None
    unknown = {name: entry for name, entry in tree.items.items() if name not in known}
    for name, entry in unknown.items():
        problems.add(entry.mark, f"{what} has no key '{name}'{hint(name, known)}")
    for name, field in known.items():
        if field.required and name not in tree.items and nearest(name, unknown) is None:
            example = next((meta.examples[0] for meta in _metas(field.type) if meta.examples), "...")
            problems.add(tree.mark, f"{what} has no {name}; add {name}: {example}")
    return {name: entry for name, entry in tree.items.items() if name in known}


class TreeReader:
    """Reads values of one file."""

    def __init__(self, file: SourceFile) -> None:
        self._file = file
        self.complete = True

    def struct(self, cls: type[Struct], tree: Tree, what: str) -> Struct | None:
        """Return a mapping as a struct, without the keys that are wrong; None if one is missing."""
        before = len(self._file.problems)
        entries = entries_of(cls, tree, what, self._file.problems)
        self.complete = self.complete and len(self._file.problems) == before
        if entries is None:
            return None
        known = fields_of(cls)
        read = {name: self.key(cls, name, entry.value, what) for name, entry in entries.items()}
        values = {known[name].name: value for name, value in read.items() if value is not UNKNOWN}
        if any(field.required and field.name not in values for field in known.values()):
            return None
        return cls(**values)

    def key(self, cls: type[msgspec.Struct], name: str, tree: Tree, what: str = "") -> Any:
        """Return the value at a key of a struct; UNKNOWN after reporting what is wrong with it."""
        return self.read(fields_of(cls)[name].type, tree, f"{name} of {what}" if what else name)

    def read(self, kind: Any, tree: Tree, what: str) -> Any:
        """Return a value that must be of a type; UNKNOWN after reporting why it is not."""
        struct = _struct_in(kind) if isinstance(tree, TreeMapping) else None
        if struct is not None:
            read = self.struct(struct, tree, what)
            return UNKNOWN if read is None else read
        value = self.evaluate(tree)
        if value is UNKNOWN:
            return UNKNOWN
        try:
            return msgspec.convert(value, kind)
        except msgspec.ValidationError as error:
            self.refuse(tree, f"{what} is '{flat(value)}'; {_wanted(error, kind, value)}")
        return UNKNOWN

    def evaluate(self, tree: Tree) -> Any:
        """Return a tree as plain values; UNKNOWN if there is a mistake in it."""
        value = self._file.evaluate(tree)
        self.complete = self.complete and value is not UNKNOWN
        return value

    def refuse(self, tree: Tree, message: str) -> None:
        self._file.problems.add(tree.mark, message)
        self.complete = False


def _parts(kind: Any) -> Iterator[Any]:
    """Yield a type, what annotates it, and the members of a union."""
    yield kind
    if hasattr(kind, "__metadata__"):
        yield from kind.__metadata__
        yield from _parts(kind.__origin__)
    elif get_origin(kind) is not Literal and get_origin(kind) not in (list, dict):
        for part in get_args(kind):
            yield from _parts(part)


def _metas(kind: Any) -> Iterable[msgspec.Meta]:
    return (part for part in _parts(kind) if isinstance(part, msgspec.Meta))


def _struct_in(kind: Any) -> type[msgspec.Struct] | None:
    return next((p for p in _parts(kind) if isinstance(p, type) and issubclass(p, msgspec.Struct)), None)


def _wanted(error: msgspec.ValidationError, kind: Any, value: Any) -> str:
    """Return what must stand in the place of a value that msgspec refused."""
    choices = [str(w) for part in _parts(kind) if get_origin(part) is Literal for w in get_args(part)]
    if choices:
        match = nearest(flat(value), choices)
        return f"it must be {' or '.join(choices)}" + (f"; did you mean '{match}'?" if match else "")
    form = next((meta.extra["form"] for meta in _metas(kind) if meta.extra and "form" in meta.extra), None)
    return in_words(error) if form is None else f"write {form}"
