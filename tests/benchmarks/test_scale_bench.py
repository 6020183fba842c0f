"""benchmarks/scale.py runs as it says, and finds what graphs of two sizes cost."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from tests.support.palp import PATIENCE_S, ROOT, Palp


@pytest.mark.nightly
def test_the_bench_prints_one_object(palp: Palp) -> None:
    command = [
        sys.executable,
        "benchmarks/scale.py",
        "--sizes",
        "2,4",
        "--rounds",
        "1",
        "--window",
        "2",
        "--json",
    ]
    done = subprocess.run(
        command,
        env=palp.environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=True,
    )
    found = json.loads(done.stdout)
    small, large = (found["sizes"][size] for size in ("2", "4"))
    assert small["lost"]["max"] == large["lost"]["max"] == 0
    assert 0.0 < small["memory_mib"]["median"] < large["memory_mib"]["median"]
    assert large["launcher_descriptors"]["median"] == small["launcher_descriptors"]["median"] + 2
    assert all(row["wakeups_per_s"]["median"] > 10.0 for row in (small, large))
    assert palp.all_gone()
