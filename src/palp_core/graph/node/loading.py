"""How a node's process begins: where it will be found, which class it runs."""

import contextlib
import hashlib
import importlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from palp_core.errors import GraphError
from palp_core.graph.node.node import Node
from palp_core.graph.workspaces.modules import install_finders, module_file, short_name


def endpoints(run_dir: str, name: str) -> tuple[str, str]:
    """Return where a node of a run publishes and where it answers."""
    return f"ipc://{run_dir}/{name}.pub", f"ipc://{run_dir}/{name}.srv"


def enter_workspace(workspace: str | Path) -> None:
    """Put a workspace first on the module path, as in a node's process.

    A console script, a notebook and pytest have neither there.
    """
    install_finders()
    workspace = str(workspace)
    if sys.path[:1] != [workspace]:
        sys.path[:] = [workspace, *(entry for entry in sys.path if entry != workspace)]
        importlib.invalidate_caches()


def load_module(name: str, workspace: str) -> ModuleType:
    """Import a module by its name, or a file by its path (relative ones count from the workspace)."""
    enter_workspace(workspace)
    if not name.endswith(".py"):
        return importlib.import_module(name)
    path = Path(workspace, name).resolve()
    # A name of its own: a file called random.py must not take the place of a module of that name.
    own_name = f"{path.stem}_{hashlib.blake2b(str(path).encode(), digest_size=6).hexdigest()}"
    spec = importlib.util.spec_from_file_location(own_name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise GraphError(f"no file {path}; check the path")
    module = importlib.util.module_from_spec(spec)
    sys.modules[own_name] = module
    spec.loader.exec_module(module)
    return module


def load_class(run: str, workspace: str, *, fresh: bool = False) -> type[Node]:
    module_name, _, class_name = run.rpartition(":")
    module_name = short_name(module_name, workspace)
    if fresh:
        _forget(module_name, workspace)
    loaded = getattr(load_module(module_name, workspace), class_name, None)
    if not (isinstance(loaded, type) and issubclass(loaded, Node)):
        raise GraphError(f"{module_name} has no node class '{class_name}'")
    return loaded


def source_of(run: str, workspace: str) -> tuple[Path, str] | None:
    """Return the file and the name of a node class, without importing anything; None if no file is known."""
    module, _, class_name = run.rpartition(":")
    if module.endswith(".py"):
        return Path(workspace, module).resolve(), class_name
    file = module_file(module, workspace)
    return (file, class_name) if file is not None else None


def class_from_here(run: str, workspace: str) -> str:
    """Return a class as somebody has typed it, the path of its file made whole.

    Args:
        run: ``module:Class``, or ``path.py:Class``: from the folder one is in, else from the workspace.
        workspace: Of the graph; "" if it has none.
    """
    file, _, name = run.rpartition(":")
    if not file.endswith(".py"):
        return run
    here, within = Path(file).resolve(), Path(workspace, file).resolve()
    return f"{within if workspace and not here.is_file() and within.is_file() else here}:{name}"


def _forget(name: str, workspace: str) -> None:
    """Let the next import read the source: a compiled file is compared by whole seconds and size only."""
    enter_workspace(workspace)
    if name.endswith(".py"):
        source: str | None = str(Path(workspace, name).resolve())
    else:
        sys.modules.pop(name, None)
        found = importlib.util.find_spec(name)
        source = found.origin if found is not None else None
    if source is not None and source.endswith(".py"):
        with contextlib.suppress(PermissionError):  # what is installed may be read-only, and is not edited
            Path(importlib.util.cache_from_source(source)).unlink(missing_ok=True)
