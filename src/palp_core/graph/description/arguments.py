"""Arguments of a launch file: declared under ``args``, given as ``name:=value`` or by an including file."""

import re
from collections.abc import Collection, Iterable
from collections.abc import Mapping as Lookup
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from palp_core.graph.description.launch_keys import RUN, ArgumentKeys
from palp_core.graph.description.substitution import Scope, evaluate
from palp_core.graph.description.tree_reader import TreeReader
from palp_core.graph.description.yaml_tree import (
    UNKNOWN,
    Entry,
    Mapping,
    Scalar,
    Sequence,
    Tree,
    parse_scalar,
    shortened,
)
from palp_core.graph.problems import Mark, Problems, hint

_KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "text", dict: "a mapping"}


@dataclass(frozen=True)
class Argument:
    """One declared argument.

    Attributes:
        name: As in ``name:=value``.
        mark: Where it is declared.
        default: Its default; UNKNOWN when it must be given.
        choices: All values it may have; empty when any of its type will do.
        help: What it means.
        sound: Its declaration has no mistake.
        sets: By its value, what it sets of other arguments and of shared parameters of its file.
        or_class: A class will do as well as a choice.
    """

    name: str
    mark: Mark
    default: Any = UNKNOWN
    choices: tuple[Any, ...] = ()
    help: str = ""
    sound: bool = True
    sets: "Lookup[str, Lookup[str, Given]]" = field(default_factory=dict)
    or_class: bool = False

    @property
    def targets(self) -> set[str]:
        """What one of its values sets."""
        return {name for defaults in self.sets.values() for name in defaults}

    @property
    def kind(self) -> type | None:
        """Type of its values, or None when neither default nor choices tell."""
        example = self.default if self.default is not UNKNOWN else next(iter(self.choices), UNKNOWN)
        return None if example is UNKNOWN else type(example)

    def names_class(self, value: object) -> bool:
        """Tell whether a value is a class of the caller's own, in place of a choice."""
        return self.or_class and isinstance(value, str) and RUN.fullmatch(value) is not None

    def clash(self, inner: "Argument") -> str:
        """Return what is wrong when an included file declares the argument, too; "" for nothing."""
        ours, theirs = self.kind, inner.kind
        if ours is None or theirs is None or ours is theirs or (ours, theirs) == (int, float):
            return ""
        return (
            f"argument '{self.name}' is {_KINDS[ours]} here, and {_KINDS[theirs]} at {inner.mark}; "
            "declare it once, or give the include its value under args"
        )


@dataclass(frozen=True)
class Given:
    """A value given for an argument.

    Attributes:
        value: The value.
        mark: Where it is given; None for the command line.
        text: As typed on the command line.
        origin: The caller's argument that decides it, if the value is just that.
    """

    value: Any
    mark: Mark | None = None
    text: str | None = None
    origin: str | None = None


def declare(
    entry: Entry | None, shared: Collection[str], scope: Scope, problems: Problems
) -> dict[str, Argument]:
    """Read the ``args`` of a launch file.

    Args:
        entry: What stands there.
        shared: Names of the file's shared parameters.
        scope: Of the file.
        problems: Receives the mistakes.
    """
    if entry is None:
        return {}
    if not isinstance(entry.value, Mapping):
        problems.add(entry.value.mark, "args must map each name to {default, choices, help}")
        return {}
    found, trees = {}, {}
    for name, item in entry.value.items.items():
        found[name], sets = _declare(name, item, scope, problems)
        if sets is not None:
            trees[name] = sets
    plain = {name: argument for name, argument in found.items() if name not in trees}
    free = set(shared)
    for name, tree in trees.items():
        scope.used.add(name)
        found[name] = replace(found[name], sets=_sets(found[name], tree, plain, free, scope, problems))
        plain = {other: argument for other, argument in plain.items() if other not in found[name].targets}
        free -= found[name].targets
    return found


def _sets(
    argument: Argument,
    tree: Tree,
    others: dict[str, Argument],
    shared: Collection[str],
    scope: Scope,
    problems: Problems,
) -> dict[str, dict[str, Given]]:
    """Read what an argument's values set; what every value sets is checked.

    Args:
        argument: The argument.
        tree: Its ``sets``.
        others: Arguments that no other argument sets and that set none themselves.
        shared: Shared parameters that no other argument sets.
        scope: Of the file.
        problems: Receives the mistakes.
    """
    what, names = f"sets of argument '{argument.name}'", [branch_name(choice) for choice in argument.choices]
    if not isinstance(tree, Mapping):
        problems.add(tree.mark, f"{what} must map its choices to values; write {{choice: {{name: value}}}}")
        return {}
    found: dict[str, dict[str, Given]] = {}
    for choice, entry in tree.items.items():
        if names and choice not in names:
            problems.add(entry.mark, f"{what}: '{choice}' is not one of its choices{hint(choice, names)}")
        elif not isinstance(entry.value, Mapping):
            problems.add(entry.value.mark, f"{what}: '{choice}' must map names to values")
        else:
            found[choice] = {}
            for name, item in entry.value.items.items():
                if name not in others and name not in shared:
                    known = hint(name, [*others, *shared])
                    text = f"{what}: '{name}' is no argument or shared parameter that it alone sets{known}"
                    problems.add(item.mark, text)
                    continue
                value = Given(evaluate(item.value, scope, problems), item.value.mark)
                if name in others:
                    _fit(others[name], value, problems)
                found[choice][name] = value
    return found


def _declare(name: str, entry: Entry, scope: Scope, problems: Problems) -> tuple[Argument, Tree | None]:
    """Return an argument, and what its values set."""
    before = len(problems)
    if not name.isidentifier():
        problems.add(entry.mark, f"'{name}' cannot be an argument's name; use letters, digits and _")
    if not isinstance(entry.value, Mapping):
        problems.add(entry.value.mark, f"argument '{name}' must be a mapping; write {name}: {{default: ...}}")
        return Argument(name, entry.mark, sound=False), None
    what, reader = f"argument '{name}'", TreeReader(scope, problems)
    fields = reader.keys(ArgumentKeys, entry.value, what) or {}
    trees = {key: item.value for key, item in fields.items()}
    default = evaluate(trees["default"], scope, problems) if "default" in trees else UNKNOWN
    if default is not UNKNOWN and type(default) not in _KINDS:
        message = f"the default of {what} must be text, a number, true or false, or a mapping"
        problems.add(trees["default"].mark, message)
        default = UNKNOWN
    unread = "default" in trees and default is UNKNOWN
    choices = _choices(name, default, fields.get("choices"), scope, problems)
    or_class = "or_class" in trees and reader.key(ArgumentKeys, "or_class", trees["or_class"], what) is True
    if or_class and not (choices and isinstance(choices[0], str)):
        problems.add(
            fields["or_class"].mark, f"{what} has or_class, but no words to choose from; give it choices"
        )
    about = trees.get("help")
    if default is not UNKNOWN and choices and default not in choices:
        message = f"the default {show(default)} of {what} is not one of its choices"
        problems.add(trees["default"].mark, message + hint(str(default), map(str, choices)))
    argument = Argument(
        name, entry.mark, default, choices, about.text if isinstance(about, Scalar) else "",
        sound=len(problems) == before and not unread, or_class=or_class,
    )  # fmt: skip
    return argument, trees.get("sets")


def _choices(
    name: str, default: Any, entry: Entry | None, scope: Scope, problems: Problems
) -> tuple[Any, ...]:
    if entry is None:
        return ()
    if not isinstance(entry.value, Sequence) or not entry.value.items:
        problems.add(entry.value.mark, f"choices of argument '{name}' must be a list of values; write [a, b]")
        return ()
    found: list[Any] = []
    for item in entry.value.items:
        value = evaluate(item, scope, problems)
        kind = type(found[0]) if default is UNKNOWN and found else type(default)
        if kind is float and type(value) is int:
            value = float(value)
        if type(value) not in _KINDS or (kind in _KINDS and type(value) is not kind):
            message = (
                f"choice {show(value)} of argument '{name}' must be {_KINDS.get(kind, 'text or a number')}"
            )
            problems.add(item.mark, message + ", as its default is")
            continue
        found.append(value)
    return tuple(found)


def from_command_line(overrides: Iterable[str], mark: Mark, problems: Problems) -> dict[str, Given]:
    """Read ``name:=value`` words; of two for one name the last counts, as in ROS 2."""
    given = {}
    for word in overrides:
        name, separator, text = word.partition(":=")
        if not separator or not name:
            problems.add(mark, f"'{word}' on the command line is not an argument; write name:=value")
            continue
        given[name] = Given(parse_scalar(text), text=text)
    return given


def assign(
    arguments: dict[str, Argument], given: dict[str, Given], caller: Mark, scope: Scope, problems: Problems
) -> None:
    """Give every argument its value in the scope; report what does not fit or is missing.

    Args:
        arguments: Declared arguments.
        given: Values for some of them.
        caller: Where a missing one is reported.
        scope: Receives the values; a wrong or missing one becomes UNKNOWN.
        problems: Receives the mistakes.
    """
    setting = {name: argument for name, argument in arguments.items() if argument.sets}
    preset: dict[str, Given] = {}
    for name, argument in (setting | arguments).items():
        chosen = argument.default
        if name in given:
            chosen = _fit(argument, given[name], problems)
        elif name in preset:
            chosen = _fit(argument, preset[name], problems)
        elif argument.default is UNKNOWN and argument.sound:
            choices = f" (one of {', '.join(map(show, argument.choices))})" if argument.choices else ""
            problems.add(
                caller, f"argument '{name}' has no default and is not given; pass {name}:=value{choices}"
            )
        value = given.get(name, Given(chosen))
        origin = scope.origins[name] = value.origin or f"{scope.file}:{name}"
        chosen = scope.forced.get(origin, chosen)
        scope.values[name] = chosen
        preset |= argument.sets.get(branch_name(chosen), {})
        if value.mark is not None and value.origin is None:
            scope.marks[name] = value.mark
    scope.preset |= {name: one for name, one in preset.items() if name not in arguments}


def refuse_unknown(
    given: dict[str, Given],
    arguments: dict[str, Argument],
    caller: Mark,
    file: Path,
    problems: Problems,
    shared: Collection[str] = (),
) -> None:
    """Report values that are given for arguments which a file does not take.

    Args:
        given: Values by argument.
        arguments: What the file takes.
        caller: Where one is reported that comes from the command line.
        file: The file.
        problems: Receives the mistakes.
        shared: Names of shared parameters, which may be meant.
    """
    for name, value in given.items():
        if name not in arguments:
            advice = f"; write shared.{name}:=..." if name in shared else hint(name, arguments)
            problems.add(value.mark or caller, f"no argument '{name}' in {file.name}{advice}")


def _fit(argument: Argument, given: Given, problems: Problems) -> Any:
    value, kind = given.value, argument.kind
    if value is UNKNOWN:
        return UNKNOWN
    if kind is str and given.text is not None and not isinstance(value, str):
        value = given.text
    if kind is float and type(value) is int:
        value = float(value)
    where = given.mark or argument.mark
    shown = show(given.value)
    if type(value) not in _KINDS or (kind is not None and type(value) is not kind):
        wanted = _KINDS.get(kind or object, "text, a number, true or false, or a mapping")
        choices = f" (one of {', '.join(map(show, argument.choices))})" if argument.choices else ""
        is_text = f" ({_what_text(given.value)})" if isinstance(given.value, str) else ""
        problems.add(
            where, f"argument '{argument.name}' is given as {shown}{is_text}; it must be {wanted}{choices}"
        )
        return UNKNOWN
    if argument.choices and value not in argument.choices and not argument.names_class(value):
        choices = ", ".join(map(show, argument.choices))
        choices += ", or a class, as in my_file.py:Mine" if argument.or_class else ""
        match = hint(str(value), map(str, argument.choices))
        match = match if "did you mean" in match else ""
        problems.add(
            where, f"argument '{argument.name}' is given as {shown}; it must be one of {choices}{match}"
        )
        return UNKNOWN
    return value


def branch_name(value: object) -> str:
    """Return an argument's value as a key of YAML."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _what_text(value: str) -> str:
    """Say what a text is that was not read as a number."""
    digits = re.fullmatch(r"[-+]?[0-9]{19,}|0o[0-7]{21,}|0x[0-9a-fA-F]{16,}", value)
    return "more than 64 bits" if digits else "text"


def show(value: Any) -> str:
    """Return a value as a launch file's author writes it, text in quotes."""
    return str(value).lower() if isinstance(value, bool) else shortened(repr(value))
