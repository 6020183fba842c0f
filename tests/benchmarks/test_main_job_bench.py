"""benchmarks/main_job.py runs as it says, and finds two turns of one checkout alike."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.palp import PATIENCE_S, ROOT, Palp


@pytest.mark.nightly
def test_the_bench_prints_one_object(palp: Palp) -> None:
    itself = Path(sys.executable).parent / "palp"
    command = [
        sys.executable,
        "benchmarks/main_job.py",
        "--start",
        "--rounds",
        "1",
        "--json",
        "--against",
        str(itself),
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
    assert found["same_bytes"]
    assert found["rounds"] == 1
    assert found["here"]["cpu_s"]["median"] > 0.0
    assert found["times_as_fast"]["median"] > 0.0
    assert palp.all_gone()
