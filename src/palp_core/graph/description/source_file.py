"""One launch file while it is resolved: its arguments with their values, and its substitutions.

An argument's value is found when it is asked for: what an include gives for it, else the value of the file
around that has an argument of this name, else the command line's, else what another argument sets, else its
default. An argument whose value the include does not give is an argument of the including file, too.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from collections.abc import Mapping as Lookup
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from palp_core.graph.description.arguments import Argument, Given, branch_name, show
from palp_core.graph.description.launch_keys import SUBSTITUTIONS
from palp_core.graph.description.yaml_tree import (
    UNKNOWN,
    Entry,
    Mapping,
    Scalar,
    Sequence,
    Tree,
    parse_scalar,
)
from palp_core.graph.problems import Mark, Problem, Problems, hint

_CALL = re.compile(r"\$\(([^()]*)\)")


class Passed(NamedTuple):
    """A value that an include gives: its place, and the file whose substitutions it has."""

    entry: Entry
    file: SourceFile


class Variable:
    """An argument of one file and what gives it its value; None: nothing but the file itself."""

    def __init__(
        self, file: SourceFile, argument: Argument, source: Variable | Passed | Given | None
    ) -> None:
        self.file, self.argument, self._source = file, argument, source
        self.used, self._asked = bool(argument.sets), False
        if isinstance(source, Variable):
            source.used = True

    @property
    def _same(self) -> Variable | None:
        """The variable whose value it has, if an include gives just that."""
        if isinstance(self._source, Passed):
            return self._source.file.variables.get(sole_variable(self._source.entry.value) or "")
        return self._source if isinstance(self._source, Variable) else None

    @property
    def origin(self) -> str:
        """What decides it: the file and name of the outermost argument whose value it has."""
        return self._same.origin if self._same is not None else f"{self.file.path}:{self.argument.name}"

    @property
    def mark(self) -> Mark | None:
        """Where an include states its value; None if none does."""
        stated = isinstance(self._source, Passed) and self._same is None
        return self._source.entry.mark if stated else None  # type: ignore[union-attr]

    @cached_property
    def value(self) -> Any:
        """The value; UNKNOWN after reporting that it does not fit or is missing."""
        if self._asked:
            what = f"argument '{self.argument.name}' takes its value from itself"
            self.file.problems.add(self.mark or self.file.place, f"{what}; give a value in its place")
            return UNKNOWN
        self._asked = True
        chosen = self._chosen()
        return self.file.forced.get(self.origin, chosen)

    def _chosen(self) -> Any:
        argument, problems, source = self.argument, self.file.problems, self._source
        match source:
            case Variable():
                return argument.fit(Given(source.value, source.argument.mark), problems)
            case Passed(entry, outer):
                return argument.fit(Given(outer.evaluate(entry.value), entry.mark), problems)
            case Given():
                return argument.fit(source, problems)
        preset = None if argument.sets else self.file.presets.get(argument.name)
        if preset is not None:
            return argument.fit(preset, problems)
        if argument.default is UNKNOWN and argument.sound:
            choices = f" (one of {', '.join(map(show, argument.choices))})" if argument.choices else ""
            what = f"argument '{argument.name}' has no default and is not given"
            problems.add(self.file.place, f"{what}; pass {argument.name}:=value{choices}")
        return argument.default


@dataclass
class SourceFile:
    """A launch file, the root or an included one.

    Attributes:
        forced: Values of arguments, by origin, in place of those that they have.
        place: Where a missing argument is reported.
        passed: Values that the include gives.
        variables: These, and those of included files whose value the include does not give.
    """

    path: Path
    items: dict[str, Entry]
    problems: Problems
    environ: Lookup[str, str]
    now: str
    forced: Lookup[str, Any]
    place: Mark
    outer: SourceFile | None = None
    passed: dict[str, Entry] = field(default_factory=dict)
    overrides: dict[str, Given] = field(default_factory=dict)
    namespace: str = ""
    own: dict[str, Argument] = field(default_factory=dict)
    variables: dict[str, Variable] = field(default_factory=dict)
    included: list[SourceFile] = field(default_factory=list)

    @property
    def arguments(self) -> dict[str, Argument]:
        """All that it takes, what came up from included files first."""
        found = {name: variable.argument for name, variable in self.variables.items() if name not in self.own}
        return found | self.own

    def take(self, own: dict[str, Argument]) -> None:
        """Take the arguments that it declares; the files around have them, too, up to where one is given."""
        self.own = own
        for name, argument in own.items():
            variable = Variable(self, argument, self.source_of(name))
            file: SourceFile | None = self
            while file is not None:
                file.variables.setdefault(name, variable)
                file = None if name in file.passed else file.outer

    def source_of(self, name: str) -> Variable | Passed | Given | None:
        """Return what gives an argument of this name its value in this file, but the file itself."""
        if self.outer is None:
            return self.overrides.get(name)
        if name in self.passed:
            return Passed(self.passed[name], self.outer)
        return self.outer.variables.get(name) or self.outer.source_of(name)

    @cached_property
    def presets(self) -> dict[str, Given]:
        """What the values of its arguments set, of other arguments and of shared parameters."""
        found: dict[str, Given] = {}
        for name, argument in self.own.items():
            if argument.sets:
                found |= argument.sets.get(branch_name(self.variables[name].value), {})
        return found

    def chain(self) -> list[SourceFile]:
        """Return the files from the root to this one, each included by the one before it."""
        return [*(self.outer.chain() if self.outer is not None else ()), self]

    def unused(self) -> Iterator[Problem]:
        """Yield its arguments, and those of the files it includes, that nothing asks for."""
        for name, argument in self.own.items():
            if not self.variables[name].used:
                text = f"argument '{name}' is never used; use $(var {name}) or remove it"
                yield Problem(*argument.mark, text)
        for included in self.included:
            yield from included.unused()

    def evaluate(self, tree: Tree) -> Any:
        """Return a tree as plain values with its substitutions made.

        A value that is exactly ``$(var x)`` has the argument's type; an unquoted one that is just
        ``$(env NAME)`` is read as YAML would. Everywhere else substitutions are pieces of text.
        """
        if isinstance(tree, Mapping):
            values: Any = {name: self.evaluate(entry.value) for name, entry in tree.items.items()}
            return UNKNOWN if UNKNOWN in values.values() else values
        if isinstance(tree, Sequence):
            values = [self.evaluate(item) for item in tree.items]
            return UNKNOWN if UNKNOWN in values else values
        if not isinstance(tree.value, str) or "$(" not in tree.value:
            return tree.value
        whole = _CALL.fullmatch(tree.value.strip())
        if whole is None:
            return self._text(tree)
        value = self._call(whole.group(1), tree.mark)
        is_plain = whole.group(1).split()[:1] == ["env"] and isinstance(value, str) and not tree.quoted
        return parse_scalar(value) if is_plain else value

    def _text(self, scalar: Scalar) -> Any:
        pieces, end = [], 0
        for call in _CALL.finditer(scalar.text):
            pieces += [scalar.text[end : call.start()], self._call(call.group(1), scalar.mark)]
            end = call.end()
        pieces.append(scalar.text[end:])
        if any("$(" in piece for piece in pieces[::2]):
            message = f"'{scalar.text}': a substitution is not closed or holds another"
            self.problems.add(scalar.mark, f"{message}; write $(name ...) without nesting")
            return UNKNOWN
        if any(piece is UNKNOWN for piece in pieces):
            return UNKNOWN
        if any(isinstance(piece, dict) for piece in pieces):
            message = f"'{scalar.text}': a mapping cannot be a piece of a text; use it alone"
            self.problems.add(scalar.mark, message)
            return UNKNOWN
        return "".join(map(branch_name, pieces))

    def _call(self, inside: str, mark: Mark) -> Any:
        name, _, rest = inside.strip().partition(" ")
        match name, rest.strip():
            case "var", variable if variable:
                return self.value_of(variable, mark)
            case "env", rest if rest:
                variable, separator, default = rest.partition(" ")
                value = self.environ.get(variable, default.strip().strip("'\"") if separator else None)
                if value is None:
                    advice = f"set it or write $(env {variable} default)"
                    self.problems.add(mark, f"environment variable {variable} is not set; {advice}")
                return UNKNOWN if value is None else value
            case "dirname", "":
                return str(self.path.parent)
            case "filename", "":
                return str(self.path)
            case "now", "":
                return self.now
            case "var" | "env", _:
                self.problems.add(mark, f"$({inside}) lacks a name; write $({name} NAME)")
            case "dirname" | "filename" | "now", _:
                self.problems.add(mark, f"$({name}) takes nothing after its name; write $({name})")
            case _:
                self.problems.add(mark, f"unknown substitution '$({inside})'{hint(name, SUBSTITUTIONS)}")
        return UNKNOWN

    def value_of(self, name: str, mark: Mark) -> Any:
        """Return the value of an argument that is asked for at a place; UNKNOWN if there is none."""
        if name not in self.variables:
            known = hint(name, self.variables)
            self.problems.add(mark, f"no argument '{name}' in this file's args{known}")
            return UNKNOWN
        self.variables[name].used = True
        return self.variables[name].value


def sole_variable(tree: Tree) -> str | None:
    """Return x when a value is exactly ``$(var x)``."""
    if not isinstance(tree, Scalar):
        return None
    call = _CALL.fullmatch(tree.text.strip())
    parts = call.group(1).split() if call else []
    return parts[1] if len(parts) == 2 and parts[0] == "var" else None
