"""One launch file while it is read: what it declares, what it is given, what it includes."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from palp_core.graph.description.arguments import Argument, Given
from palp_core.graph.description.launch_file import Located
from palp_core.graph.description.substitution import Scope, sole_variable
from palp_core.graph.description.tree_reader import TreeReader
from palp_core.graph.description.yaml_tree import UNKNOWN, Entry, Mapping, Scalar, Tree
from palp_core.graph.problems import Problem, Problems


@dataclass
class SourceFile:
    """A launch file, the root or an included one, and what is known of its arguments.

    Attributes:
        path: Where it is.
        fields: Its keys.
        scope: What its substitutions see.
        own: Arguments that it declares.
        outer: The file that includes it; None for the root.
        given: Values given for its arguments by the include, or on the command line.
        included: Files that it includes.
        taken: Arguments of included files that are arguments of this one, too.
        namespace: What goes before the names of its nodes; "" for nothing.
    """

    path: Path
    fields: dict[str, Entry]
    scope: Scope
    own: dict[str, Argument]
    outer: "SourceFile | None" = None
    given: dict[str, Given] = field(default_factory=dict)
    included: list["SourceFile"] = field(default_factory=list)
    taken: dict[str, Argument] = field(default_factory=dict)
    namespace: str = ""

    @property
    def arguments(self) -> dict[str, Argument]:
        """All that it takes, what came up from included files first."""
        return {**self.taken, **self.own}

    def take(self, inner: "SourceFile") -> None:
        """Make the arguments of an included file this one's, but those whose value the include gives."""
        for name, argument in inner.arguments.items():
            if name in inner.scope.values and name not in inner.given and name not in self.arguments:
                self.taken[name] = argument
                self.scope.values[name] = inner.scope.values[name]
                self.scope.origins[name] = inner.scope.origins[name]

    def offer(self, argument: Argument, problems: Problems) -> Given | None:
        """Return the value that this file or one around it has for an included file's argument, if any."""
        name = argument.name
        if name in self.arguments:
            ours = self.arguments[name]
            self.scope.used.add(name)
            if clash := ours.clash(argument):
                problems.add(ours.mark, clash)
            value = UNKNOWN if clash else self.scope.values[name]
            return Given(value, ours.mark, origin=self.scope.origins[name])
        if name in self.given:
            return self.given[name]
        return self.outer.offer(argument, problems) if self.outer is not None else None

    def uses(self, name: str) -> bool:
        """Tell whether this file asks for an argument, or one around it that has taken it."""
        outer = self.outer
        around = outer is not None and outer.taken.get(name) is self.arguments[name] and outer.uses(name)
        return name in self.scope.used or around

    def chain(self) -> "list[SourceFile]":
        """Return the files from the root to this one, each included by the one before it."""
        return [*(self.outer.chain() if self.outer is not None else ()), self]

    def unused(self) -> Iterator[Problem]:
        """Yield its arguments, and those of the files it includes, that nothing asks for."""
        for name, argument in self.own.items():
            if not self.uses(name):
                text = f"argument '{name}' is never used; use $(var {name}) or remove it"
                yield Problem(*argument.mark, text)
        for included in self.included:
            yield from included.unused()


def locate(reader: TreeReader, file: SourceFile, tree: Tree, what: str) -> dict[str, Located]:
    """Return named values, each with where it is given, and by which argument."""
    if not isinstance(tree, Mapping):
        if not (isinstance(tree, Scalar) and tree.value is None):
            reader.refuse(tree, f"{what} must map each parameter to its value")
        return {}
    found = {}
    for name, entry in tree.items.items():
        value = reader.evaluate(entry.value)
        if value is not UNKNOWN:
            argument = sole_variable(entry.value) or ""
            declared = file.arguments.get(argument)
            origin = file.scope.origins.get(argument, "")
            is_default = declared is not None and value == declared.default
            mark = file.scope.marks.get(argument, entry.mark)
            found[name] = Located(value, mark, is_default or origin in file.scope.forced, origin)
    return found
