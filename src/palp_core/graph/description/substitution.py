"""Substitutions: ``$(var x)``, ``$(env NAME default)``, ``$(dirname)``, ``$(filename)``, ``$(now)``."""

import re
from collections.abc import Mapping as Lookup
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from palp_core.graph.clock import local_time_name
from palp_core.graph.description.launch_keys import SUBSTITUTIONS
from palp_core.graph.description.yaml_tree import UNKNOWN, Mapping, Scalar, Sequence, Tree, parse_scalar
from palp_core.graph.problems import Mark, Problems, hint

_CALL = re.compile(r"\$\(([^()]*)\)")


@dataclass
class Scope:
    """What the substitutions of one launch file see.

    Attributes:
        file: The launch file.
        environ: Environment variables.
        values: Value of each argument.
        origins: For each argument, the name under which the root file's caller decides it.
        used: Arguments that the file has asked for.
        marks: Where an include states the value of an argument.
        now: The host's local time at launch, as names of files have it.
        forced: Values of arguments, by origin, in place of those that they have.
        preset: What values of arguments set of the file's shared parameters.
    """

    file: Path
    environ: Lookup[str, str]
    values: dict[str, Any] = field(default_factory=dict)
    origins: dict[str, str] = field(default_factory=dict)
    used: set[str] = field(default_factory=set)
    marks: dict[str, Mark] = field(default_factory=dict)
    now: str = field(default_factory=local_time_name)
    forced: Lookup[str, Any] = field(default_factory=dict)
    preset: dict[str, Any] = field(default_factory=dict)


def sole_variable(tree: Tree) -> str | None:
    """Return x when a value is exactly ``$(var x)``."""
    if not isinstance(tree, Scalar):
        return None
    call = _CALL.fullmatch(tree.text.strip())
    words = call.group(1).split() if call else []
    return words[1] if len(words) == 2 and words[0] == "var" else None


def evaluate(tree: Tree, scope: Scope, problems: Problems) -> Any:
    """Return a tree as plain values with its substitutions made.

    A value that is exactly ``$(var x)`` has the argument's type; an unquoted one that is just ``$(env NAME)``
    is read as YAML would. Everywhere else substitutions are pieces of text.

    Returns:
        The value, or UNKNOWN when a substitution failed; the mistake is then in ``problems``.
    """
    if isinstance(tree, Mapping):
        values: Any = {name: evaluate(entry.value, scope, problems) for name, entry in tree.items.items()}
        return UNKNOWN if UNKNOWN in values.values() else values
    if isinstance(tree, Sequence):
        values = [evaluate(item, scope, problems) for item in tree.items]
        return UNKNOWN if UNKNOWN in values else values
    if not isinstance(tree.value, str) or "$(" not in tree.value:
        return tree.value
    text = tree.value.strip()
    whole = _CALL.fullmatch(text)
    if whole is not None:
        value = _call(whole.group(1), tree.mark, scope, problems)
        from_environment = whole.group(1).split()[:1] == ["env"]
        return (
            parse_scalar(value) if from_environment and isinstance(value, str) and not tree.quoted else value
        )
    return _text(tree, scope, problems)


def _text(scalar: Scalar, scope: Scope, problems: Problems) -> Any:
    pieces, end = [], 0
    for call in _CALL.finditer(scalar.text):
        pieces += [scalar.text[end : call.start()], _call(call.group(1), scalar.mark, scope, problems)]
        end = call.end()
    pieces.append(scalar.text[end:])
    if any("$(" in piece for piece in pieces[::2]):
        message = f"'{scalar.text}': a substitution is not closed or holds another"
        problems.add(scalar.mark, f"{message}; write $(name ...) without nesting")
        return UNKNOWN
    if any(piece is UNKNOWN for piece in pieces):
        return UNKNOWN
    if any(isinstance(piece, dict) for piece in pieces):
        problems.add(scalar.mark, f"'{scalar.text}': a mapping cannot be a piece of a text; use it alone")
        return UNKNOWN
    return "".join(str(piece).lower() if isinstance(piece, bool) else str(piece) for piece in pieces)


def _call(inside: str, mark: Mark, scope: Scope, problems: Problems) -> Any:
    name, _, rest = inside.strip().partition(" ")
    rest = rest.strip()
    match name:
        case "var" if rest:
            scope.used.add(rest)
            if rest not in scope.values:
                problems.add(mark, f"no argument '{rest}' in this file's args{hint(rest, scope.values)}")
            return scope.values.get(rest, UNKNOWN)
        case "env" if rest:
            variable, separator, default = rest.partition(" ")
            value = scope.environ.get(variable, default.strip().strip("'\"") if separator else None)
            if value is None:
                problems.add(
                    mark,
                    f"environment variable {variable} is not set; set it or write $(env {variable} default)",
                )
                return UNKNOWN
            return value
        case "dirname" if not rest:
            return str(scope.file.parent)
        case "filename" if not rest:
            return str(scope.file)
        case "now" if not rest:
            return scope.now
        case "var" | "env":
            problems.add(mark, f"$({inside}) lacks a name; write $({name} NAME)")
        case "dirname" | "filename" | "now":
            problems.add(mark, f"$({name}) takes nothing after its name; write $({name})")
        case _:
            problems.add(mark, f"unknown substitution '$({inside})'{hint(name, SUBSTITUTIONS)}")
    return UNKNOWN
