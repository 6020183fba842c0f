"""The face of the library: its names are there, and nothing loads that is not used."""

from __future__ import annotations

import ast
import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import palp_core
from tests.docs.pages import blocks
from tests.support.palp import ROOT

HEAVY = ("palp_core.palpation", "scipy", "pandas", "matplotlib", "pywt", "statsmodels", "serial", "can")


def loaded_by(program: str) -> list[str]:
    program += (
        f"\nimport sys, json; print(json.dumps([name for name in sys.modules if name.startswith({HEAVY!r})]))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    found: list[str] = json.loads(done.stdout.splitlines()[-1])
    return found


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


@pytest.mark.parametrize(
    "program",
    [
        "import palp_core",
        "import palp_core.graph",
        "from palp_core import *",
        "import palp_core; [getattr(palp_core, name) for name in palp_core.__all__]",
    ],
)
def test_the_face_loads_nothing_of_palpation_and_nothing_heavy(program: str) -> None:
    assert loaded_by(program) == []


def test_the_face_itself_loads_no_module_of_palps() -> None:
    program = "import palp_core, sys; print([name for name in sys.modules if name.startswith('palp_core.')])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


TUTORIAL = ROOT / "docs" / "tutorial" / "first_node.md"
SPY = """
import json, sys
from palp_core import Node
class Spy(Node):
    def on_activate(self):
        with open("loaded.json", "w") as file:
            json.dump([name for name in sys.modules if name.startswith(%r)], file)
"""


def write_tutorial(folder: Path) -> None:
    """Write the files that the tutorial begins with into a folder."""
    for block in blocks(TUTORIAL.read_text(encoding="utf-8")):
        if block.file in ("count.py", "count.yaml"):
            (folder / block.file).write_text(block.text, encoding="utf-8")


def typed_in(folder: Path, lines: str) -> str:
    """Run lines in a shell that has ``python`` and ``palp``; return what they print."""
    commands = folder / "bin"
    commands.mkdir()
    for name, words in (("python", ""), ("palp", "-m palp_core")):
        (commands / name).write_text(f'#!/bin/sh\nexec {sys.executable} {words} "$@"\n')
        (commands / name).chmod(0o755)
    environment = {
        **os.environ,
        "PATH": f"{commands}:{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT / "src"),
    }
    done = subprocess.run(
        ["bash", "-ec", lines], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("compose", [False, True])
def test_the_processes_of_the_tutorial_load_nothing_of_palpation_and_nothing_heavy(
    tmp_path: Path, compose: bool
) -> None:
    write_tutorial(tmp_path)
    (tmp_path / "spy.py").write_text(SPY % (HEAVY,))
    with (tmp_path / "count.yaml").open("a") as file:
        file.write("  spy: {run: spy.py:Spy}\n")
    program = (
        f"from palp_core import Graph\nwith Graph('count.yaml', compose={compose}) as graph: graph.run()"
    )
    typed_in(tmp_path, f'python -c "{program}"')
    assert json.loads((tmp_path / "loaded.json").read_text()) == []
