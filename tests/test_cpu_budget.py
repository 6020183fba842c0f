"""The CPU budget of a test: what counts, and what fails."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from tests.support.cpu_budget import BUDGETS_S, budget_of, cpu_s
from tests.support.palp import ROOT

PLUGIN = """
import pytest
from tests.support import cpu_budget

cpu_budget.LIMIT_S = 0.1
cpu_budget.slowness = lambda: 1.0


def pytest_configure(config):
    config.addinivalue_line("markers", "expensive(reason): allowed")
    config.pluginmanager.register(cpu_budget.CpuMeter())
    config.pluginmanager.register(cpu_budget.CpuSummary())
"""
TESTS = """
import subprocess, sys
import pytest

def burn(seconds=0.3):
    program = f"import time\\nwhile time.process_time() < {seconds}: pass"
    subprocess.run([sys.executable, "-c", program], check=True)


@pytest.fixture(scope="module")
def shared():
    burn()


def test_shared(shared): pass
def test_cheap(): pass
def test_burns(): burn(0.6)
@pytest.mark.expensive("it burns")
def test_allowed(): burn()
"""


def test_a_test_whose_processes_take_too_much_fails_unless_it_is_marked(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text(PLUGIN, encoding="utf-8")
    (tmp_path / "test_burning.py").write_text(TESTS, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:xdist", "-p", "no:hypothesispytest", "--durations=1"],
        cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "1 failed, 3 passed" in done.stdout
    assert "test_burns: took" in done.stdout
    assert re.findall(r"^ +[0-9.]+  (.*)$", done.stdout, re.MULTILINE) == ["test_burning.py::test_burns"]


def test_a_process_counts_while_it_lives_and_when_it_has_ended() -> None:
    before_s = cpu_s()
    burning = "import time\nwhile time.process_time() < 0.3: pass\nprint(flush=True)\ninput()"
    with subprocess.Popen(
        [sys.executable, "-c", burning], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        child.stdout.readline()
        living_s = cpu_s() - before_s
        child.communicate("\n")
    assert living_s >= 0.25  # ticks of 10 ms
    assert cpu_s() - before_s >= living_s


def test_a_folder_counts_for_the_longest_name_that_fits() -> None:
    assert budget_of("tests/graph/swap/test_swap.py") == "tests/graph/swap"
    assert budget_of("tests/graph/bag/test_writer.py") == "tests/graph"
    assert budget_of("src/palp_core/units.py") == ""
    assert all((ROOT / folder).is_dir() for folder in BUDGETS_S)
