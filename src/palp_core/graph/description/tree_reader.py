"""Read parts of a YAML tree by the struct that says what may stand there; every mistake has its place."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Iterable
from typing import Any, TypeVar

import msgspec
from msgspec import inspect

from palp_core.graph.description.substitution import Scope, evaluate
from palp_core.graph.description.yaml_tree import UNKNOWN, Entry, Mapping, Tree, shortened
from palp_core.graph.problems import Problems, hint, nearest

Struct = TypeVar("Struct", bound=msgspec.Struct)
fields_of = functools.cache(
    lambda cls: {field.encode_name: field for field in inspect.type_info(cls).fields}  # type: ignore[attr-defined]
)
"""Return the fields of a struct by the key that each is at."""


def flat(value: object) -> str:
    """Return a value as YAML writes it."""
    return str(value).lower() if isinstance(value, bool) else shortened(str(value))


def unknown_keys(mapping: Mapping, known: Iterable[str], what: str, problems: Problems) -> dict[str, Entry]:
    """Return the known entries of a mapping; report the others at their line, with the nearest known name."""
    names = tuple(known)
    for name, entry in mapping.items.items():
        if name not in names:
            problems.add(entry.mark, f"{what} has no key '{name}'{hint(name, names)}")
    return {name: entry for name, entry in mapping.items.items() if name in names}


class TreeReader:
    """Reads values of one file.

    Args:
        scope: What its substitutions see.
        problems: Receives the mistakes.

    Attributes:
        complete: Nothing that was read had a mistake.
    """

    def __init__(self, scope: Scope, problems: Problems) -> None:
        self.scope = scope
        self.problems = problems
        self.complete = True

    def struct(self, cls: type[Struct], tree: Tree, what: str) -> Struct | None:
        """Return a mapping as a struct, without the keys that are wrong; None if one is missing.

        Args:
            cls: What may stand there.
            tree: The mapping.
            what: How messages call it.
        """
        fields = self.keys(cls, tree, what)
        if fields is None:
            return None
        known = fields_of(cls)
        read = {name: self.key(cls, name, entry.value, what) for name, entry in fields.items()}
        values = {known[name].name: value for name, value in read.items() if value is not UNKNOWN}
        if any(field.required and field.name not in values for field in known.values()):
            return None
        return cls(**values)

    def keys(self, cls: type[msgspec.Struct], tree: Tree, what: str) -> dict[str, Entry] | None:
        """Return the entries of a mapping whose keys a struct has; a required one that lacks is reported."""
        known = fields_of(cls)
        if not isinstance(tree, Mapping):
            self.refuse(tree, f"{what} must be a mapping with the keys {', '.join(known)}")
            return None
        entries = unknown_keys(tree, known, what, self.problems)
        unknown = set(tree.items) - set(entries)
        self.complete = self.complete and not unknown
        for name, field in known.items():
            if field.required and name not in entries and nearest(name, unknown) is None:
                self.refuse(tree, f"{what} has no {name}; add {name}: {_form_of(field.type)}")
        return entries

    def key(self, cls: type[msgspec.Struct], name: str, tree: Tree, what: str = "") -> Any:
        """Return the value at a key of a struct; UNKNOWN after reporting what is wrong with it."""
        return self.read(fields_of(cls)[name].type, tree, f"{name} of {what}" if what else name)

    def read(self, kind: inspect.Type, tree: Tree, what: str) -> Any:
        """Return a value that must be of a type; UNKNOWN after reporting why it is not."""
        more: dict[str, Any] = {}
        while isinstance(kind, inspect.Metadata):
            more, kind = {**(kind.extra or {}), **more}, kind.type
        if isinstance(kind, inspect.UnionType):
            struct = [one for one in kind.types if isinstance(one, inspect.StructType)]
            if isinstance(tree, Mapping) and struct:
                return self.read(struct[0], tree, what)
            (plain,) = (one for one in kind.types if not isinstance(one, inspect.StructType))
            return self.read(plain, tree, what)
        if isinstance(kind, inspect.StructType):
            read = self.struct(kind.cls, tree, what)
            return UNKNOWN if read is None else read
        value = self.evaluate(tree)
        if value is UNKNOWN or _fits(kind, value):
            return float(value) if isinstance(kind, inspect.FloatType) and value is not UNKNOWN else value
        wanted = _wanted(kind, value, more.get("form", ""))
        self.refuse(tree, f"{what} is '{flat(value)}'; {wanted}")
        return UNKNOWN

    def evaluate(self, tree: Tree) -> Any:
        """Return a tree as plain values; UNKNOWN if there is a mistake in it."""
        value = evaluate(tree, self.scope, self.problems)
        self.complete = self.complete and value is not UNKNOWN
        return value

    def refuse(self, tree: Tree, message: str) -> None:
        """Report a mistake."""
        self.problems.add(tree.mark, message)
        self.complete = False


def _fits(kind: inspect.Type, value: Any) -> bool:
    match kind:
        case inspect.Metadata():
            return _fits(kind.type, value)
        case inspect.AnyType():
            return True
        case inspect.LiteralType():
            return isinstance(value, str) and value in kind.values
        case inspect.BoolType():
            return isinstance(value, bool)
        case inspect.IntType():
            return type(value) is int and _is_within(kind, value)
        case inspect.FloatType():
            return type(value) in (int, float) and math.isfinite(value) and _is_within(kind, value)
        case inspect.StrType():
            return isinstance(value, str) and re.fullmatch(kind.pattern or "(?s).+", value) is not None
        case inspect.ListType():
            return isinstance(value, list) and all(_fits(kind.item_type, item) for item in value)
    raise AssertionError(kind)


def _is_within(kind: inspect.IntType | inspect.FloatType, value: float) -> bool:
    return (kind.ge is None or value >= kind.ge) and (kind.le is None or value <= kind.le)


def _wanted(kind: inspect.Type, value: Any, form: str) -> str:
    """Return what must stand in a value's place."""
    match kind:
        case inspect.LiteralType():
            words = [str(word) for word in kind.values]
            match_ = nearest(flat(value), words)
            return f"it must be {' or '.join(words)}" + (f"; did you mean '{match_}'?" if match_ else "")
        case inspect.BoolType():
            return "it must be true or false"
        case inspect.IntType() | inspect.FloatType():
            noun = "a whole number" if isinstance(kind, inspect.IntType) else "a number"
            bounds = f"of at least {kind.ge}" if kind.le is None else f"from {kind.ge} to {kind.le:,}"
            return f"it must be {noun} {bounds}, without quotes"
        case inspect.ListType():
            return "write a list, as in [a, b]"
    return f"write {form or 'a text'}"


def _form_of(kind: inspect.Type) -> str:
    """Return an example of what stands at a required key."""
    while isinstance(kind, inspect.Metadata):
        examples = (kind.extra_json_schema or {}).get("examples")
        if examples:
            return str(examples[0])
        kind = kind.type
    return "..."
