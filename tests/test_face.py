"""The face of the library: its names are there, and nothing loads that is not used."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import pytest

import palp_core


def test_each_name_is_the_one_that_a_type_checker_sees() -> None:
    tree = ast.parse(Path(palp_core.__file__).read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    seen = {
        alias.name: getattr(importlib.import_module(str(node.module)), alias.name)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert {name: getattr(palp_core, name) for name in palp_core.__all__} == seen
    assert set(palp_core.__all__) <= set(dir(palp_core))


def test_everything_can_be_imported_at_once() -> None:
    names: dict[str, object] = {}
    exec("from palp_core import *", names)
    assert set(palp_core.__all__) <= set(names)


def test_a_misspelt_name_gets_the_nearest() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Grahp'; did you mean 'Graph'"):
        palp_core.Grahp  # noqa: B018
    with pytest.raises(ImportError, match="cannot import name 'Publisher'"):
        exec("from palp_core import Publisher")
