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
from typing import Any, TypeVar

import yaml

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.scene import OUTPUTS, STRAINS, Scene, StagePath, Tolerance
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
    root = read_mapping(path, "scene")
    fields = root.items("the scene", _keys(Scene))
    given: dict[str, Any] = {}
    if "phantom" in fields:
        given["phantom"] = phantom_of(fields["phantom"], "phantom")
    if "probe" in fields:
        given["probe"] = _struct(fields["probe"], "probe", Probe)
    if "path" in fields:
        given["path"] = _struct(fields["path"], "path", StagePath)
    if "ring_m" in fields:
        given["ring_m"] = fields["ring_m"].numbers("ring_m")
    if "tolerance" in fields:
        given["tolerance"] = _tolerance(fields["tolerance"])
    if "budget_s" in fields:
        given["budget_s"] = fields["budget_s"].number("budget_s")
    return _made(root, fields, Scene, given)


def phantom_of(node: SceneNode, what: str) -> Phantom:
    """Return the phantom that a mapping describes."""
    fields = node.items(what, _keys(Phantom))
    given: dict[str, Any] = {name: f.number(name) for name, f in fields.items() if name != "bead"}
    if "bead" in fields:
        bead = fields["bead"]
        if bead.text is None:
            given["bead"] = _struct(bead, f"{what}.bead", Bead)
        elif bead.text.lower() in ("none", "null", "~", ""):
            given["bead"] = None
        else:
            raise bead.error(f"{what}.bead must be a mapping of depth_m and radius_m, or 'none'")
    places = fields | (fields["bead"].items(f"{what}.bead") if given.get("bead") is not None else {})
    return _made(node, places, Phantom, given)


def _keys(kind: type) -> list[str]:
    """Return the keys of what fills a class; its docstring is what the reference says of them."""
    return [field.name for field in dataclasses.fields(kind)]


def _tolerance(node: SceneNode) -> Tolerance:
    fields = node.items("tolerance", _keys(Tolerance))
    given: dict[str, Any] = {}
    if "output" in fields:
        given["output"] = fields["output"].text
        if given["output"] not in OUTPUTS:
            raise fields["output"].error(f"tolerance.output must be one of {', '.join(OUTPUTS)}")
    if "relative" in fields:
        given["relative"] = fields["relative"].number("relative")
    if "strain" in fields:
        given["strain"] = fields["strain"].text
        if given["strain"] not in STRAINS:
            raise fields["strain"].error(f"tolerance.strain must be one of {', '.join(STRAINS)}")
    if "depths_m" in fields:
        given["depths_m"] = fields["depths_m"].numbers("depths_m")
    return _made(node, fields, Tolerance, given)


def _struct(node: SceneNode, what: str, kind: type[T]) -> T:
    """Return a dataclass of numbers, and of words where a default is one."""
    fields = node.items(what, _keys(kind))
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        if field.name not in fields and field.default is dataclasses.MISSING:
            raise node.error(f"{what} needs {field.name}")
    words = {f.name for f in dataclasses.fields(kind) if isinstance(f.default, str)}  # type: ignore[arg-type]
    given = {
        name: (value.text or "a collection") if name in words else value.number(name)
        for name, value in fields.items()
    }
    return _made(node, fields, kind, given)


def _made(node: SceneNode, fields: dict[str, SceneNode], kind: type[T], given: dict[str, Any]) -> T:
    """Call a dataclass; what is out of range is reported where it was written."""
    try:
        return kind(**given)
    except OutOfRange as error:
        raise fields.get(error.quantity, node).error(str(error)) from error
