"""Read the ``args`` of a launch file."""

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import msgspec

from palp_core.graph.description.arguments import KINDS, Argument, Given, as_kind, branch_name, show
from palp_core.graph.description.launch_keys import ArgumentKeys
from palp_core.graph.description.source_file import SourceFile
from palp_core.graph.description.tree_reader import TreeReader
from palp_core.graph.description.yaml_tree import UNKNOWN, Entry, Mapping, Tree
from palp_core.graph.problems import hint


def read_arguments(file: SourceFile) -> dict[str, Argument]:
    """Return the arguments that a launch file declares; of a value that sets others, they are checked too."""
    entry = file.items.get("args")
    if entry is None:
        return {}
    if not isinstance(entry.value, Mapping):
        file.problems.add(entry.value.mark, "args must map each name to {default, choices, help}")
        return {}
    found = {name: _read(name, item, file) for name, item in entry.value.items.items()}
    trees = {name: sets for name, item in entry.value.items.items() if (sets := _sets_of(item)) is not None}
    shared = file.items["shared"].value if "shared" in file.items else None
    free = {name: argument for name, argument in found.items() if name not in trees}
    shared_names = set(shared.items) if isinstance(shared, Mapping) else set()
    for name, tree in trees.items():
        found[name] = replace(found[name], sets=_read_sets(found[name], tree, free, shared_names, file))
        free = {key: argument for key, argument in free.items() if key not in found[name].targets}
        shared_names -= found[name].targets
    return found


def _sets_of(entry: Entry) -> Tree | None:
    sets = entry.value.items.get("sets") if isinstance(entry.value, Mapping) else None
    return None if sets is None else sets.value


def _read(name: str, entry: Entry, file: SourceFile) -> Argument:
    problems, what = file.problems, f"argument '{name}'"
    before = len(problems)
    if not name.isidentifier():
        problems.add(entry.mark, f"'{name}' cannot be an argument's name; use letters, digits and _")
    if not isinstance(entry.value, Mapping):
        problems.add(entry.value.mark, f"{what} must be a mapping; write {name}: {{default: ...}}")
        return Argument(name, entry.mark, sound=False)
    trees = {key: item.value for key, item in entry.value.items.items()}
    plain = Mapping(entry.value.mark, {k: e for k, e in entry.value.items.items() if k != "sets"})
    reader = TreeReader(file)
    keys = reader.struct(ArgumentKeys, plain, what) or ArgumentKeys()
    default = UNKNOWN if keys.default is msgspec.UNSET else keys.default
    if default is not UNKNOWN and type(default) not in KINDS:
        message = f"the default of {what} must be text, a number, true or false, or a mapping"
        problems.add(trees["default"].mark, message)
        default = UNKNOWN
    choices = _fitting(keys.choices, default, what, trees, file)
    if keys.or_class and not (choices and isinstance(choices[0], str)):
        text = f"{what} has or_class, but no words to choose from; give it choices"
        problems.add(trees["or_class"].mark, text)
    if default is not UNKNOWN and choices and default not in choices:
        message = f"the default {show(default)} of {what} is not one of its choices"
        problems.add(trees["default"].mark, message + hint(str(default), map(str, choices)))
    sound = len(problems) == before and reader.complete
    return Argument(name, entry.mark, default, choices, keys.help, sound, or_class=keys.or_class)


def _fitting(
    choices: list[Any], default: Any, what: str, trees: dict[str, Tree], file: SourceFile
) -> tuple[Any, ...]:
    """Return the choices that are of the default's type, or of that of the first of them."""
    found: list[Any] = []
    for choice in choices:
        example = default if default is not UNKNOWN or not found else found[0]
        kind = None if example is UNKNOWN else type(example)
        try:
            found.append(as_kind(choice, kind))
        except msgspec.ValidationError:
            wanted = KINDS.get(kind or object, "text or a number")
            text = f"choice {show(choice)} of {what} must be {wanted}, as its default is"
            file.problems.add(trees["choices"].mark, text)
    return tuple(found)


def _read_sets(
    argument: Argument,
    tree: Tree,
    others: dict[str, Argument],
    shared: Collection[str],
    file: SourceFile,
) -> dict[str, dict[str, Given]]:
    """Return what an argument's values set, of what no other one sets; what every value sets is checked."""
    problems, what = file.problems, f"sets of argument '{argument.name}'"
    names = [branch_name(choice) for choice in argument.choices]
    if not isinstance(tree, Mapping):
        problems.add(tree.mark, f"{what} must map its choices to values; write {{choice: {{name: value}}}}")
        return {}
    found: dict[str, dict[str, Given]] = {}
    for choice, entry in tree.items.items():
        if names and choice not in names:
            problems.add(entry.mark, f"{what}: '{choice}' is not one of its choices{hint(choice, names)}")
            continue
        if not isinstance(entry.value, Mapping):
            problems.add(entry.value.mark, f"{what}: '{choice}' must map names to values")
            continue
        found[choice] = {}
        for name, item in entry.value.items.items():
            if name not in others and name not in shared:
                known = hint(name, [*others, *shared])
                text = f"{what}: '{name}' is no argument or shared parameter that it alone sets{known}"
                problems.add(item.mark, text)
                continue
            value = found[choice][name] = Given(file.evaluate(item.value), item.value.mark)
            if name in others:
                others[name].fit(value, problems)
    return found
