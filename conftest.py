"""Before any test is found: how many at a time, threads of linear algebra, where examples are, the order."""

from __future__ import annotations

import compileall
import gc
import os
import sys
from collections.abc import Generator
from pathlib import Path

import pytest

from tests.support.cpu_budget import CpuMeter, CpuSummary

ROOT = Path(__file__).parent
SOURCE = ROOT / "src"
RIGS = ROOT / "tests" / "rig"
COMPILED = ("src", "nodes", "msgs", "tests/support")

# As the command line does, and before anything imports numpy: the workers take the cores already, and small
# matrices take nearly twice the time on two threads.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")


sys.dont_write_bytecode = False  # or each worker of each run rewrites the asserts of all tests


def pytest_xdist_auto_num_workers() -> int:
    """Take one worker more than there are cores: some tests wait, and each worker costs a collection."""
    return len(os.sched_getaffinity(0)) + 1


def pytest_configure(config: pytest.Config) -> None:
    """Meter the CPU time; compile the source once, where Python may not keep what each process compiles."""
    config.pluginmanager.register(CpuMeter())
    if "PYTEST_XDIST_WORKER" not in os.environ:
        config.pluginmanager.register(CpuSummary())
        for folder in COMPILED:
            compileall.compile_dir(ROOT / folder, quiet=2)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Look for no garbage among what is imported, neither while it is nor ever after."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Pass over a source file without an example: pytest would import it only to find that out."""
    if collection_path.suffix != ".py" or SOURCE not in collection_path.parents:
        return None
    return b">>>" not in collection_path.read_bytes() or None


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(
    file_path: Path,
) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Look for examples in the source only: in a test there are none."""
    found = yield
    return found if SOURCE in file_path.parents else [one for one in found if type(one) is pytest.Module]


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let whole rigs come first: the longest tests, of which none should be left over for the end."""
    items.sort(key=lambda item: RIGS not in item.path.parents)
