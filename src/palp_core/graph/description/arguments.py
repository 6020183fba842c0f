"""Arguments of a launch file: what each may be, and whether a value fits."""

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import msgspec

from palp_core.graph.description.launch_keys import RUN
from palp_core.graph.description.yaml_tree import UNKNOWN, parse_scalar, shortened
from palp_core.graph.problems import Mark, Problems, hint, nearest

KINDS: Mapping[type, str] = {
    bool: "true or false", int: "a whole number", float: "a number", str: "text", dict: "a mapping",
}  # fmt: skip


class Given(NamedTuple):
    """A value for an argument: its place, None for the command line, and there as typed."""

    value: Any
    mark: Mark | None = None
    text: str | None = None


@dataclass(frozen=True)
class Argument:
    """One declared argument."""

    name: str
    mark: Mark
    default: Any = UNKNOWN
    choices: tuple[Any, ...] = ()
    help: str = ""
    sound: bool = True
    sets: Mapping[str, Mapping[str, Given]] = field(default_factory=dict)  # by its value, by name
    or_class: bool = False

    @property
    def targets(self) -> set[str]:
        """What one of its values sets."""
        return {name for defaults in self.sets.values() for name in defaults}

    @property
    def kind(self) -> type | None:
        """Type of its values, or None when neither default nor choices show it."""
        example = self.default if self.default is not UNKNOWN else next(iter(self.choices), UNKNOWN)
        return None if example is UNKNOWN else type(example)

    def names_class(self, value: object) -> bool:
        """Return whether a value is a class of the caller's own, in place of a choice."""
        return self.or_class and isinstance(value, str) and RUN.fullmatch(value) is not None

    def fit(self, given: Given, problems: Problems) -> Any:
        """Return a given value with the argument's type; UNKNOWN after reporting why it has not."""
        value, kind = given.value, self.kind
        if value is UNKNOWN:
            return UNKNOWN
        if kind is str and given.text is not None and not isinstance(value, str):
            value = given.text
        what = f"argument '{self.name}' is given as {show(given.value)}"
        choices = ", ".join(map(show, self.choices))
        try:
            value = as_kind(value, kind)
        except msgspec.ValidationError:
            wanted = KINDS.get(kind or object, "text, a number, true or false, or a mapping")
            text = f" ({_kind_of_text(given.value)})" if isinstance(given.value, str) else ""
            listed = f" (one of {choices})" if choices else ""
            problems.add(given.mark or self.mark, f"{what}{text}; it must be {wanted}{listed}")
            return UNKNOWN
        if choices and value not in self.choices and not self.names_class(value):
            choices += ", or a class, as in my_file.py:Mine" if self.or_class else ""
            match = nearest(str(value), map(str, self.choices))
            advice = f"; did you mean '{match}'?" if match else ""
            problems.add(given.mark or self.mark, f"{what}; it must be one of {choices}{advice}")
            return UNKNOWN
        return value


def as_kind(value: Any, kind: type | None) -> Any:
    """Return a value as one of a type that an argument can have; None: any of them."""
    return msgspec.convert(value, kind or bool | int | float | str | dict[str, Any])


def read_overrides(overrides: Iterable[str], mark: Mark, problems: Problems) -> dict[str, Given]:
    """Read ``name:=value`` of the command line; of two for one name the last counts, as in ROS 2."""
    given = {}
    for word in overrides:
        name, separator, text = word.partition(":=")
        if not separator or not name:
            problems.add(mark, f"'{word}' on the command line is not an argument; write name:=value")
            continue
        given[name] = Given(parse_scalar(text), text=text)
    return given


def refuse_unknown(
    given: Mapping[str, Mark],
    known: Iterable[str],
    file: str,
    problems: Problems,
    shared: Collection[str] = (),
) -> None:
    """Report values for arguments that a file does not take; ``shared`` parameters may be meant."""
    names = list(known)
    for name, mark in given.items():
        if name not in names:
            advice = f"; write shared.{name}:=..." if name in shared else hint(name, names)
            problems.add(mark, f"no argument '{name}' in {file}{advice}")


def branch_name(value: object) -> str:
    """Return an argument's value as a key of YAML."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def show(value: Any) -> str:
    """Return a value as a launch file's author writes it, text in quotes."""
    return str(value).lower() if isinstance(value, bool) else shortened(repr(value))


def _kind_of_text(value: str) -> str:
    """Return why a text was not read as a number."""
    digits = re.fullmatch(r"[-+]?[0-9]{19,}|0o[0-7]{21,}|0x[0-9a-fA-F]{16,}", value)
    return "more than 64 bits" if digits else "text"
