"""Digests of the code that methods are made of: what was measured is as old as that code."""

import ast
import hashlib
import importlib.util
from functools import cache
from pathlib import Path

from palp_core.methods import Method

_QUOTES = str.maketrans("", "", "\"'")  # which differ between versions of Python for the same f-string


def method_digest(method: Method) -> str:
    """Return a digest of a method's code: its module's, and that of what it imports from its own room.

    A room is a package; that of a module outside any package is its folder.

    Docstrings, comments and layout are left out, so that words may change; and files of stated bounds, which
    change nothing that is measured.

    Args:
        method: As declared.
    """
    room = _room(method.module)
    left, seen = [method.module], set[str]()
    while left:
        name = left.pop()
        if name not in seen:
            seen.add(name)
            left += [one for one in _imports(name) if _room(one) == room and not one.endswith("_bounds")]
    total = hashlib.sha256()
    for name in sorted(seen):
        total.update(f"{name}\0{_code(name)}\0".encode())
    return total.hexdigest()[:16]


@cache
def _room(module: str) -> str:
    """Return a module's package; its folder, if it is in none."""
    if package := module.rpartition(".")[0]:
        return package
    found = importlib.util.find_spec(module)
    return str(Path(found.origin).parent) if found and found.origin else ""


@cache
def _tree(module: str) -> ast.Module:
    found = importlib.util.find_spec(module)
    if found is None or found.origin is None or not found.origin.endswith(".py"):
        return ast.Module([], [])
    return ast.parse(Path(found.origin).read_text(encoding="utf-8"))


@cache
def _imports(module: str) -> list[str]:
    """Return the modules that a module imports, wherever in it."""
    names: list[str] = []
    for node in ast.walk(_tree(module)):
        if isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{one.name}" for one in node.names)]
        elif isinstance(node, ast.Import):
            names += [one.name for one in node.names]
    return [name for name in names if _is_module(name)]


@cache
def _is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except (ImportError, ValueError):  # a name of a module, which is no package
        return False


@cache
def _code(module: str) -> str:
    """Return a module's code without its docstrings."""
    bare = _Bare().visit(ast.parse(ast.unparse(_tree(module))))
    return ast.unparse(bare).translate(_QUOTES)


class _Bare(ast.NodeTransformer):
    """Takes away texts that stand for themselves."""

    def generic_visit(self, node: ast.AST) -> ast.AST:
        super().generic_visit(node)
        body = getattr(node, "body", None)
        if isinstance(body, list):
            kept = [one for one in body if not _is_text(one)]
            node.body = kept or [ast.Pass()]  # type: ignore[attr-defined]
        return node


def _is_text(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )
