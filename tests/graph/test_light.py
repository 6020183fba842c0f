"""A graph that knows nothing of palpation loads nothing of it, and nothing heavy."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

ALL = """
import importlib, pkgutil
import palp_core.graph
names = [found.name for found in pkgutil.walk_packages(palp_core.graph.__path__, "palp_core.graph.")]
assert len(names) > 100
for name in names:
    importlib.import_module(name)
"""
HEAVY = (
    "palp_core.palpation",
    "matplotlib",
    "pandas",
    "pywt",
    "scipy",
    "skfem",
    "statsmodels",
    "serial",
    "can",
)


@pytest.mark.parametrize(
    "imports", ["import palp_core.graph.launch.graph", ALL], ids=["a graph", "every room"]
)
def test_a_graph_loads_nothing_of_palpation_and_nothing_heavy(imports: str) -> None:
    show = f"import sys; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", f"{imports}\n{show}"], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_a_nodes_process_knows_nothing_of_the_register_of_methods() -> None:
    """What a codec or a delivery is declared to be is for who asks; a message does not wait for it."""
    code = "import palp_core.graph.process.main, nodes.rig_torque, sys"
    code += "; print('palp_core.methods' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "False"
