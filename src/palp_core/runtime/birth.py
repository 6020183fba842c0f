"""How a node's process begins: what it is told, where it will be found, which class it runs."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path

import msgspec

from palp_core.errors import GraphError
from palp_core.runtime.node import Node
from palp_core.runtime.spec import NodeSpec

__all__ = ["NodeProcess", "endpoints", "load_class"]


class NodeProcess(msgspec.Struct, frozen=True, kw_only=True):
    """What a node's process is told when it is born."""

    spec: NodeSpec
    clock: str
    run_dir: str
    workspace: str


def endpoints(run_dir: str, name: str) -> tuple[str, str]:
    """Return where a node of a run publishes and where it answers."""
    return f"ipc://{run_dir}/{name}.pub", f"ipc://{run_dir}/{name}.srv"


def load_class(run: str, workspace: str) -> type[Node]:
    """Import ``module:Class`` or ``path.py:Class`` with the workspace first on the path.

    Raises:
        GraphError: No such class, or it is not a node.
    """
    module_name, _, class_name = run.rpartition(":")
    if workspace and workspace not in sys.path:
        sys.path.insert(0, workspace)
    if module_name.endswith(".py"):
        path = Path(workspace, module_name) if not Path(module_name).is_absolute() else Path(module_name)
        spec = importlib.util.spec_from_file_location(path.stem, path)
        if spec is None or spec.loader is None or not path.exists():
            raise GraphError(f"{path}: no such file; needed for '{run}'")
        module = importlib.util.module_from_spec(spec)
        sys.modules[path.stem] = module
        spec.loader.exec_module(module)
    else:
        module = importlib.import_module(module_name)
    loaded = getattr(module, class_name, None)
    if not (isinstance(loaded, type) and issubclass(loaded, Node)):
        raise GraphError(f"{module_name} has no node class '{class_name}'")
    return loaded
