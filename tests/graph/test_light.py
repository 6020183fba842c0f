"""A graph that knows nothing of palpation loads nothing of it, and nothing heavy."""

from __future__ import annotations

import subprocess
import sys

import pytest

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
