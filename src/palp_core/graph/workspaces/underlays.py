"""Workspaces that are installed as packages: under the workspace one is in, as an underlay of ROS 2.

A package publishes a workspace (a folder with ``nodes/``, ``msgs/`` and ``launch/``) by an entry point::

    [project.entry-points."palp.workspaces"]
    softlab = "softlab.workspace"        # name -> package that has the folders in it

Then ``softlab:probe.yaml`` is a launch file wherever one is taken, and a module of ``nodes`` or ``msgs`` that
the workspace one is in does not have is found there. One that it does have takes the installed one's place.
"""

import importlib.util
import re
from collections.abc import Sequence
from functools import cache
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import NamedTuple

from palp_core.errors import GraphError
from palp_core.graph.problems import hint, nearest
from palp_core.published import published

GROUP = "palp.workspaces"
SHARED = ("nodes", "msgs")
"""The packages of a workspace that others find in it, too."""

_FOLDERS = (*SHARED, "launch")
_NAMED = re.compile(r"(?P<workspace>[A-Za-z_][\w-]*):(?P<file>[^:]*)")
_OWN = "palp_core."


class Underlay(NamedTuple):
    """An installed workspace.

    Attributes:
        package: Whose modules its nodes and messages are, too: ``palp_core.workspace``.
    """

    name: str
    package: str
    folder: Path

    def launch_files(self) -> list[str]:
        """Return its launch files' names, those that are only included by others left out."""
        return sorted(path.name for path in (self.folder / "launch").glob("*.yaml"))


@cache
def underlays() -> tuple[Underlay, ...]:
    """Return the installed workspaces, in the order in which modules are looked for in them.

    That is by name, palp's own last: everybody's lies over it. What has no folder is left out.
    """
    found = {
        Underlay(name, package, folder)
        for name, package in published(GROUP).items()
        if (folder := _folder(package)) is not None
    }
    return tuple(sorted(found, key=lambda underlay: (underlay.package.startswith(_OWN), underlay.name)))


def underlay(name: str) -> Underlay:
    known = {found.name: found for found in underlays()}
    if name not in known:
        raise GraphError(f"no installed workspace '{name}'{hint(name, known)}")
    return known[name]


def launch_path(file: str | Path) -> Path:
    """Return where a launch file is: ``rig:sim.yaml`` is one of the installed workspace ``rig``."""
    named = _NAMED.fullmatch(str(file))
    if named is None or Path(file).exists():
        return Path(file)
    workspace, name = underlay(named["workspace"]), named["file"]
    path = workspace.folder / "launch" / name
    if name and path.is_file() and path.resolve().is_relative_to((workspace.folder / "launch").resolve()):
        return path
    known = workspace.launch_files()
    near = f" did you mean '{workspace.name}:{match}'?" if (match := nearest(name, known)) else ""
    listed = ", ".join(known) or "none"
    raise GraphError(f"{file}: no launch file '{name}' in {workspace.folder};{near} there are: {listed}")


def is_installed_name(file: str | Path) -> bool:
    """Tell whether a launch file is named by its workspace, as in ``rig:sim.yaml``."""
    return _NAMED.fullmatch(str(file)) is not None


def _folder(package: str) -> Path | None:
    """Return the folder of a package's workspace: its own, or a checkout's; nothing is imported."""
    top, _, rest = package.partition(".")
    found = importlib.util.find_spec(top)  # in an editable install a finder of its own may know it
    if found is not None and rest:
        found = spec_below(rest, list(found.submodule_search_locations or ()))
    for place in (found.submodule_search_locations or ()) if found is not None else ():
        if any(Path(place, name).is_dir() for name in _FOLDERS):
            return Path(place)
        for parent in Path(place).parents:
            if (parent / "pyproject.toml").is_file():
                return parent if any((parent / name).is_dir() for name in _FOLDERS) else None
    return None


def spec_below(name: str, folders: Sequence[str]) -> ModuleSpec | None:
    """Return what is known of a module in one of some folders, or None."""
    found, places = None, folders
    for part in name.split("."):
        found = PathFinder.find_spec(part, places)
        if found is None:
            return None
        places = list(found.submodule_search_locations or ())
    return found
