"""Classes of the workspace that may take a node's place: found by reading its files, without running them.

So may those of the installed workspaces that lie under it, whatever of them it does not replace.

A candidate declares every output that somebody reads of the node, by name and type as written, and no input
that the node has no wire for, but optional ones. Whether it really fits is for the launcher to say: a dry run
asks it.
"""

from __future__ import annotations

import ast
import functools
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

MOST_FILES = 500
LONGEST_FILE = 1 << 20
_READING = threading.Lock()
"""Pages look on threads, and Python 3.11's parser fails where two of them make a tree (SystemError)."""


class PortText(msgspec.Struct, frozen=True):
    """A port as a class declares it: ``Sub`` or ``Pub``, the type as written, whether it may stay open."""

    kind: str
    type: str
    optional: bool = False


class ClassText(msgspec.Struct, frozen=True):
    """A class of a file, read and not run: ``module:Class``, its bases, its ports."""

    run: str
    bases: list[str]
    ports: dict[str, PortText]


def classes_of(workspace: Path) -> Iterator[ClassText]:
    for path in sorted((workspace / "nodes").glob("*.py"))[:MOST_FILES]:
        try:
            entry = path.stat()
            if entry.st_size > LONGEST_FILE:
                continue
            with _READING:
                found = _classes_in(path, entry.st_mtime_ns, entry.st_size)
        except (OSError, ValueError, SyntaxError, RecursionError):
            continue  # a file that is being written, or is no Python: it is no choice
        yield from found


@functools.lru_cache(maxsize=4 * MOST_FILES)
def _classes_in(path: Path, _mtime_ns: int, _size: int) -> tuple[ClassText, ...]:
    """Return the classes of a file, which is read again only when it has changed."""
    return tuple(
        ClassText(f"nodes.{path.stem}:{defined.name}", _bases(defined), _ports(defined))
        for defined in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(defined, ast.ClassDef)
    )


def fitting(
    workspace: Path, run: str, read: set[str], wired: set[str], below: Sequence[Path] = ()
) -> list[str]:
    """Return the classes that may take a node's place, but for the one that has it."""
    known, bases = _known([workspace, *below])
    ports = {name: _all_ports(found, known) for name, found in known.items()}
    own = ports.get(run, {})
    return [
        name
        for name, has in ports.items()
        if name != run and name not in bases and _fits(has, own, read, wired)
    ]


def _known(workspaces: Sequence[Path]) -> tuple[dict[str, ClassText], set[str]]:
    """Return the classes of workspaces that lie over each other, and which of them their own folder extends.

    What one's own workspace derives from an installed class hides none: that one is a choice as before.
    """
    known: dict[str, ClassText] = {}
    bases, taken = set[str](), set[str]()
    for workspace in workspaces:
        here = {one.run: one for one in classes_of(workspace) if one.run.partition(":")[0] not in taken}
        extended = {base for one in here.values() for base in one.bases}
        bases.update(run for run in here if run.rpartition(":")[2] in extended)
        known |= here
        taken |= {f"nodes.{path.stem}" for path in (workspace / "nodes").glob("*.py")}
    return known, bases


def _fits(has: dict[str, PortText], own: dict[str, PortText], read: set[str], wired: set[str]) -> bool:
    outputs = {name for name, port in has.items() if port.kind == "Pub"}
    inputs = {name for name, port in has.items() if port.kind == "Sub" and not port.optional}
    alike = all(has[name].type == own[name].type for name in read | wired if name in has and name in own)
    return bool(has) and read <= outputs and inputs <= wired and alike


def _all_ports(found: ClassText, known: dict[str, ClassText], depth: int = 8) -> dict[str, PortText]:
    """Return a class's ports with those of its bases in the workspace."""
    ports: dict[str, PortText] = {}
    for base in found.bases if depth else ():
        for other in known.values():
            if other.run.rpartition(":")[2] == base and other is not found:
                ports |= _all_ports(other, known, depth - 1)
    return ports | found.ports


def _bases(defined: ast.ClassDef) -> list[str]:
    return [ast.unparse(base).rpartition(".")[2] for base in defined.bases]


def _ports(defined: ast.ClassDef) -> dict[str, PortText]:
    found = {}
    for statement in defined.body:
        value = getattr(statement, "value", None)
        if not (
            isinstance(statement, ast.Assign | ast.AnnAssign) and isinstance(value, ast.Call) and value.args
        ):
            continue
        target = statement.targets[0] if isinstance(statement, ast.Assign) else statement.target
        kind = ast.unparse(value.func).rpartition(".")[2]
        if kind in ("Sub", "Pub") and isinstance(target, ast.Name):
            optional = any(
                word.arg == "optional" and ast.unparse(word.value) == "True" for word in value.keywords
            )
            found[target.id] = PortText(kind, ast.unparse(value.args[0]).rpartition(".")[2], optional)
    return found
