"""Before any test is found: how many at a time, threads of linear algebra, files of the source with tests."""

from __future__ import annotations

import os
from pathlib import Path

SOURCE = Path(__file__).parent / "src"

# As the command line does, and before anything imports numpy: the workers take the cores already, and small
# matrices take nearly twice the time on two threads.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")


def pytest_xdist_auto_num_workers() -> int:
    """Take one worker more than there are cores: tests of processes wait more than they compute."""
    return len(os.sched_getaffinity(0)) + 1


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Pass over a source file without an example: pytest would import it only to find that out."""
    if collection_path.suffix != ".py" or SOURCE not in collection_path.parents:
        return None
    return b">>>" not in collection_path.read_bytes() or None
