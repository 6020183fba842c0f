"""The face of a package: its names load from their modules when they are first used."""

from __future__ import annotations

import ast
import difflib
import importlib
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any


def lazy_names(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a package whose names are in other modules.

    Where a name is, its ``__init__.py`` states once: in the imports for type checkers, below
    ``if TYPE_CHECKING``. They are read when the first name is asked for.
    """
    module = sys.modules[package]

    @cache
    def homes() -> dict[str, str]:
        tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
        (block,) = [node for node in tree.body if isinstance(node, ast.If)]
        imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
        return {alias.name: str(node.module) for node in imports for alias in node.names}

    def load(name: str) -> Any:
        if name not in homes():
            near = difflib.get_close_matches(name, homes(), n=1)
            hint = f"; did you mean '{near[0]}'?" if near else ""
            raise AttributeError(f"module '{package}' has no attribute '{name}'{hint}")
        found = getattr(importlib.import_module(homes()[name]), name)
        setattr(module, name, found)
        return found

    return load, lambda: sorted({*vars(module), *homes()})
