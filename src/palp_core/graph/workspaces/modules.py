"""How modules of installed workspaces are found: what one's own lacks, and by long names."""

import importlib
import importlib.util
import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import spec_from_file_location, spec_from_loader
from pathlib import Path
from types import ModuleType

from palp_core.graph.workspaces.underlays import SHARED, Underlay, spec_below, underlays


def module_file(module: str, workspace: str) -> Path | None:
    """Return the file of a module, as an import from a workspace would find it; nothing is imported."""
    own = _of_package(module)
    if own is not None:
        found: ModuleSpec | None = spec_below(own[1], [str(own[0].folder)])
    else:
        found = spec_below(module, [workspace, *sys.path]) or _underlying(module)
    return Path(found.origin).resolve() if found is not None and found.origin else None


def short_name(module: str, workspace: str) -> str:
    """Return what a module is called in the workspace, if it is known by its package: ``nodes.policy``.

    A module whose place another of the workspace has taken keeps its long name.
    """
    own = _of_package(module)
    if own is None or module_file(own[1], workspace) != module_file(module, workspace):
        return module
    return own[1]


def hidden_modules(workspace: str | Path) -> list[tuple[str, Path, Path, str]]:
    """Return which modules of a workspace take the place of other ones that are installed."""
    found = []
    for kind in SHARED:
        for file in sorted(Path(workspace, kind).rglob("*.py")):
            part = file.relative_to(workspace)
            for underlay in underlays():
                hidden = underlay.folder / part
                if hidden.is_file() and not hidden.samefile(file):
                    if hidden.read_bytes() != file.read_bytes() and file.name != "__init__.py":
                        found.append((".".join(part.with_suffix("").parts), file, hidden, underlay.name))
                    break
    return found


def install_finders() -> None:
    """Let imports find what is installed: last ``nodes`` and ``msgs``, first those names within a package."""
    if _ALIASES not in sys.meta_path:
        sys.meta_path.insert(0, _ALIASES)
    if _UNDERLYING not in sys.meta_path:
        sys.meta_path.append(_UNDERLYING)


class _Underlying(MetaPathFinder):
    """Finds modules of ``nodes`` and ``msgs`` that no other finder has found."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        return _underlying(fullname)


class _Aliases(MetaPathFinder):
    """Makes ``palp_core.workspace.nodes.policy`` the module ``nodes.policy``: no class exists twice.

    Where the workspace one is in has a ``nodes.policy`` of its own, the long name is still the installed one,
    so that what takes its place can be derived from it.
    """

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        named = _of_package(fullname)
        if named is None:
            return None
        installed = spec_below(named[1], [str(named[0].folder)])
        if installed is None or installed.origin is None:
            return None
        if _same(plain := _plain(named[1]), installed):
            assert plain is not None
            is_package = plain.submodule_search_locations is not None
            return spec_from_loader(fullname, _Alias(named[1]), origin=plain.origin, is_package=is_package)
        places = installed.submodule_search_locations
        return spec_from_file_location(fullname, installed.origin, submodule_search_locations=places)


class _Alias(Loader):
    def __init__(self, name: str) -> None:
        self._name = name

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return None

    def exec_module(self, module: ModuleType) -> None:
        assert module.__spec__ is not None
        sys.modules[module.__spec__.name] = importlib.import_module(self._name)


_ALIASES, _UNDERLYING = _Aliases(), _Underlying()


def _underlying(name: str) -> ModuleSpec | None:
    """Return a module of ``nodes`` or ``msgs`` in the first installed workspace that has it."""
    package, _, last = name.rpartition(".")
    if name.partition(".")[0] not in SHARED:
        return None
    for underlay in underlays():
        folder = underlay.folder.joinpath(*package.split("."))
        found = PathFinder.find_spec(name, [str(folder)]) if last else None
        if found is not None:
            return found
    return None


def _of_package(name: str) -> tuple[Underlay, str] | None:
    """Return the installed workspace in whose package a module is, and what it is called in the workspace."""
    if not any(f".{kind}" in name for kind in SHARED):  # nearly every import: spare it what asking costs
        return None
    for underlay in underlays():
        rest = name.removeprefix(f"{underlay.package}.")
        if rest != name and rest.partition(".")[0] in SHARED:
            return underlay, rest
    return None


def _plain(name: str) -> ModuleSpec | None:
    """Return what importing a module by its short name gives or would give."""
    loaded = sys.modules.get(name)
    if loaded is not None:
        return loaded.__spec__
    try:
        return importlib.util.find_spec(name)
    except ModuleNotFoundError:  # what is called nodes there is no package
        return None


def _same(spec: ModuleSpec | None, installed: ModuleSpec) -> bool:
    if spec is None or spec.origin is None or installed.origin is None:
        return False
    return Path(spec.origin).resolve() == Path(installed.origin).resolve()
