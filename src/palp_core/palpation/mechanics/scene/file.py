"""Scenes and phantoms from YAML files, every mistake named with file, line, column and the nearest key.

::

    phantom: {modulus_pa: 20000.0, poisson: 0.49, height_m: 0.030, bead: {radius_m: 0.0075, depth_m: 0.004}}
    probe: {tip_radius_m: 0.006, friction: 0.3, tip_mass_kg: 0.008}
    path: {indentation_m: 0.004, speed_m_s: 0.02, from_m: -0.03, to_m: 0.05}
    ring_m: [0.004, 0.016]
    tolerance: {output: contrast, relative: 0.05}
    budget_s: 10.0

What is left out has its default; ``bead: none`` is bare gel.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Sequence
from pathlib import Path
from types import NoneType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import yaml

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.whole_file import read_whole, why_not

_LARGEST_BYTES = 256 << 10

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class SceneNode:
    """A YAML node with the file it is in."""

    file: str
    node: yaml.Node

    def error(self, message: str, at: yaml.Node | None = None) -> MechanicsError:
        """Return an error that says where."""
        mark = (at or self.node).start_mark
        return MechanicsError(f"{self.file}:{mark.line + 1}:{mark.column + 1}: {message}")

    def items(self, what: str, known: Sequence[str] = ()) -> dict[str, SceneNode]:
        """Return the entries of a mapping; ``known`` lists the keys it may have, none means any."""
        if not isinstance(self.node, yaml.MappingNode):
            keys = ", ".join(known) or "names"
            raise self.error(f"{what} must be a mapping of {keys}")
        found: dict[str, SceneNode] = {}
        for key, value in self.node.value:
            name = key.value if isinstance(key, yaml.ScalarNode) else "?"
            if known and name not in known:
                near = difflib.get_close_matches(name, known, n=1)
                hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known)}"
                raise self.error(f"{what} has no key '{name}'; {hint}", key)
            if name in found:
                raise self.error(f"{what} gives '{name}' twice", key)
            found[name] = SceneNode(self.file, value)
        return found

    @property
    def text(self) -> str | None:
        """The text of a scalar, None for anything else."""
        return str(self.node.value) if isinstance(self.node, yaml.ScalarNode) else None

    def number(self, name: str) -> float:
        """Return a number; 20e3 is one, NaN is left to the range checks."""
        try:
            return float((self.text or "").lower().replace(".inf", "inf").replace(".nan", "nan"))
        except ValueError:
            raise self.error(
                f"{name} must be a number in SI units, not '{self.text or 'a collection'}'"
            ) from None

    def numbers(self, name: str) -> tuple[float, ...]:
        """Return a list of numbers, or one number as a list."""
        if not isinstance(self.node, yaml.SequenceNode):
            return (self.number(name),)
        return tuple(SceneNode(self.file, node).number(name) for node in self.node.value)


def read_mapping(path: str | Path, what: str) -> SceneNode:
    """Return the root of a YAML file."""
    try:
        root = yaml.compose(read_whole(path, _LARGEST_BYTES).decode(), Loader=yaml.CSafeLoader)
    except (OSError, UnicodeDecodeError) as error:
        reason = why_not(error, path) if isinstance(error, OSError) else "it is not UTF-8 text"
        raise MechanicsError(f"{path}: cannot read the {what}: {reason}") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{path}:{mark.line + 1}:{mark.column + 1}" if mark else str(path)
        raise MechanicsError(f"{where}: no YAML: {error.problem or error.context}") from error
    except (yaml.YAMLError, RecursionError) as error:
        raise MechanicsError(f"{path}: no YAML: {error}") from error
    if root is None:
        raise MechanicsError(f"{path}:1:1: the file is empty; it should hold the {what}")
    return SceneNode(str(path), root)


def read_scene(path: str | Path) -> Scene:
    """Return the scene of a file.

    Raises:
        MechanicsError: As the module says, or a value is out of range.
    """
    return build(Scene, read_mapping(path, "scene"), "the scene")


def build(kind: type[T], node: SceneNode, what: str) -> T:
    """Return a dataclass of numbers, words and further dataclasses; an optional one may be ``none``."""
    own = {field.name: field for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    types, fields = get_type_hints(kind), node.items(what, list(own))
    for field in own.values():
        if field.name not in fields and field.default is field.default_factory is dataclasses.MISSING:
            raise node.error(f"{what} needs {field.name}")
    given, places = dict[str, Any](), dict(fields)
    for name, value in fields.items():
        wanted, optional = types[name], NoneType in get_args(types[name])
        if optional:
            wanted = next(one for one in get_args(wanted) if one is not NoneType)
        if optional and (value.text or "").lower() in ("none", "null", "~"):
            given[name] = None
        elif isinstance(wanted, type) and dataclasses.is_dataclass(wanted):
            if optional and value.text is not None:
                raise value.error(f"{what}.{name} must be a mapping, or 'none'")
            given[name] = build(wanted, value, name if kind is Scene else f"{what}.{name}")
            places = value.items(name) | places  # a part that does not fit the whole is named at its place
        elif wanted is str:
            given[name] = value.text or "a collection"
        elif get_origin(wanted) is tuple:
            given[name] = value.numbers(name)
        else:
            given[name] = value.number(name)
    try:
        return kind(**given)
    except OutOfRange as error:
        raise places.get(error.quantity, node).error(str(error)) from error
