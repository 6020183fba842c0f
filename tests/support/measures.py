"""The measures of the source: length of a file, width of a class, size of a folder; no twins, no circles.

A file is one idea and a class one thing; what outgrows its measure wants another object, not another file. So
a class that was cut in two for its length, a base of one heir next door, counts, too.
"""

from __future__ import annotations

import ast
import dataclasses
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from functools import cached_property
from pathlib import Path

import grimp
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

PACKAGES = ("palp_core", "nodes", "msgs")
SOURCE = ("src", "nodes", "msgs")
MEASURED = (*SOURCE, "tests", "benchmarks")
LONGEST_FILE = 500
MOST_METHODS = 12
MOST_FILES = 24
APART = {"Message", "Params", "Protocol", "State"}
"""Their heirs are forms of data or of behaviour: one heir next door is no class cut in two."""

SAME_NAME: dict[str, str] = {
    "Belief": "the message msgs.estimation:Belief carries it",
    "Emg": "nodes.policy_emg:Emg is the policy of that name, like nodes.policy_fixed:Fixed",
    "Phantom": "the node nodes.phantom:Phantom is it in the simulated rig",
}
"""Top-level classes that share a name, with the cause."""


@dataclasses.dataclass(frozen=True)
class Tree:
    """The files of a repository, read once."""

    root: Path

    @cached_property
    def texts(self) -> dict[str, str]:
        """Return the text of each file, by its path from the root."""
        paths = [path for folder in MEASURED for path in sorted((self.root / folder).rglob("*.py"))]
        return {path.relative_to(self.root).as_posix(): path.read_text(encoding="utf-8") for path in paths}

    @cached_property
    def modules(self) -> dict[str, ast.Module]:
        """Return the syntax of each file but the tests, of which only the length is measured."""
        return {name: ast.parse(text) for name, text in self.texts.items() if not name.startswith("tests/")}

    def findings(self) -> Iterator[str]:
        """Yield everything that does not keep its measure."""
        yield from self.files()
        yield from self.folders()
        yield from self.classes()
        yield from self.namesakes()
        yield from self.only_heirs()
        yield from self.circles()

    def files(self) -> Iterator[str]:
        """A file is at most 500 lines, and the source says what each is for."""
        for name, text in self.texts.items():
            if (lines := len(text.splitlines())) > LONGEST_FILE:
                yield f"{name} has {lines} lines; at most {LONGEST_FILE} are one idea"
        for name, module in self.source():
            if not ast.get_docstring(module):
                yield f"{name}: say in one line what the module is for"

    def folders(self) -> Iterator[str]:
        """A folder has at most 24 files."""
        for folder, count in Counter(name.rpartition("/")[0] for name in self.texts).items():
            if count > MOST_FILES:
                yield f"{folder} has {count} files; at most {MOST_FILES} are a room"

    def classes(self) -> Iterator[str]:
        """A class has at most 12 public methods, properties included; a test's may have more."""
        for name, module in self.modules.items():
            for defined in classes_among(ast.walk(module)):
                public = {
                    statement.name
                    for statement in defined.body
                    if isinstance(statement, (ast.FunctionDef, ast.AsyncFunctionDef))
                    and not statement.name.startswith("_")
                }
                if len(public) > MOST_METHODS:
                    words = f"{name}: {defined.name} has {len(public)} public methods; at most {MOST_METHODS}"
                    yield f"{words} are one thing"

    def namesakes(self) -> Iterator[str]:
        """No two public classes of the source have one name, but for a few with a cause."""
        places = defaultdict(list)
        for name, module in self.source():
            for defined in classes_among(module.body):
                if not defined.name.startswith("_"):
                    places[defined.name].append(name)
        for name, files in places.items():
            if len(files) > 1 and name not in SAME_NAME:
                yield f"{name} is a class in {', '.join(files)}; say two things in two words"
        for name in SAME_NAME:
            if len(places[name]) < 2:
                yield f"{name} is one class now; take it out of SAME_NAME"

    def only_heirs(self) -> Iterator[str]:
        """No class that only its one heir next door names: the two are one class in two pieces."""
        homes: dict[str, list[str]] = defaultdict(list)
        heirs: dict[str, list[tuple[str, ast.ClassDef]]] = defaultdict(list)
        named: Counter[str] = Counter()
        for name, module in self.source():
            for statement in ast.walk(module):
                if isinstance(statement, ast.ClassDef):
                    bases = bases_of(statement)
                    for base in bases:
                        heirs[base].append((name, statement))
                    if not {*bases} & APART:
                        homes[statement.name].append(name)
                elif isinstance(statement, (ast.Name, ast.Attribute)):
                    named[statement.id if isinstance(statement, ast.Name) else statement.attr] += 1
        for base, files in homes.items():
            if len(files) == len(heirs[base]) == named[base] == 1:
                place, heir = heirs[base][0]
                if place.rpartition("/")[0] == files[0].rpartition("/")[0]:
                    words = f"nobody names {base} but its only heir {heir.name} in {place}"
                    yield f"{files[0]}: {words}; make them one"

    def circles(self) -> Iterator[str]:
        """No module, and no room of a package, imports itself by way of others; for types alone it may."""
        graph = grimp.build_graph(
            *PACKAGES, include_external_packages=False, exclude_type_checking_imports=True, cache_dir=None
        )
        arrows = {(a, b) for a in graph.modules for b in graph.find_modules_directly_imported_by(a)}
        rooms = {(a, b) for a, b in (where_they_part(*arrow) for arrow in arrows) if a != b}
        for circle in {*circles_in(arrows), *circles_in(rooms)}:
            yield f"{', '.join(circle)} import each other in a circle"

    def source(self) -> Iterable[tuple[str, ast.Module]]:
        """Return the files that are not tests or benchmarks."""
        return [(name, module) for name, module in self.modules.items() if name.startswith(SOURCE)]


def classes_among(statements: Iterable[ast.AST]) -> list[ast.ClassDef]:
    """Return those that define a class."""
    return [statement for statement in statements if isinstance(statement, ast.ClassDef)]


def bases_of(defined: ast.ClassDef) -> list[str]:
    """Return the last words of a class's bases, without what is in brackets."""
    bases = [base.value if isinstance(base, ast.Subscript) else base for base in defined.bases]
    return [ast.unparse(base).rpartition(".")[2] for base in bases]


def where_they_part(importer: str, imported: str) -> tuple[str, str]:
    """Return the two rooms of the innermost package that holds both.

    >>> where_they_part("palp.graph.node.ports", "palp.graph.messages.qos")
    ('palp.graph.node', 'palp.graph.messages')
    """
    mine, theirs = importer.split("."), imported.split(".")
    shared = 0
    while shared < min(len(mine), len(theirs)) and mine[shared] == theirs[shared]:
        shared += 1
    return ".".join(mine[: shared + 1]), ".".join(theirs[: shared + 1])


def circles_in(arrows: set[tuple[str, str]]) -> list[tuple[str, ...]]:
    """Return the groups of names that reach each other along the arrows."""
    names = sorted({name for arrow in arrows for name in arrow})
    place = {name: index for index, name in enumerate(names)}
    ends = [place[a] for a, _ in arrows], [place[b] for _, b in arrows]
    matrix = coo_array(([1] * len(arrows), ends), shape=(len(names), len(names)))
    groups = defaultdict(list)
    for name, group in zip(names, connected_components(matrix, connection="strong")[1], strict=True):
        groups[group].append(name)
    return [tuple(group) for group in groups.values() if len(group) > 1]
