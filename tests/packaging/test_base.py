"""The base alone: graphs of one's own work, and what needs more says in one line what to install."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from palp_core import extras
from tests.support.palp import CHAIN, PATIENCE_S, Palp

RUN = "from palp_core.__main__ import main; main()"


@pytest.fixture
def base(tmp_path: Path, palp: Palp) -> dict[str, str]:
    """Return surroundings in which no extra is installed, for every process that is started in them."""
    lacking = f"import sys\nsys.modules.update(dict.fromkeys({sorted(extras._EXTRA_OF)!r}))\n"
    (tmp_path / "site").mkdir()
    (tmp_path / "site/sitecustomize.py").write_text(lacking, encoding="utf-8")
    before = [os.environ[name] for name in ("PYTHONPATH",) if os.environ.get(name)]
    return palp.environment | {"PYTHONPATH": os.pathsep.join([str(tmp_path / "site"), *before])}


def said(
    base: dict[str, str], folder: Path, program: str, *words: object
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program, *map(str, words)],
        cwd=folder, env=base, capture_output=True, text=True, check=False, timeout=PATIENCE_S,
    )  # fmt: skip


def test_a_graph_of_ones_own_runs_is_recorded_and_looked_into(base: dict[str, str], tmp_path: Path) -> None:
    launched = said(base, tmp_path, RUN, "launch", CHAIN, "clock:=sim", "count:=20", "--record", "bag")
    assert launched.returncode == 0, launched.stderr
    assert "Sample" in said(base, tmp_path, RUN, "bag", "info", "bag").stdout


ONE_AFTER_THE_OTHER = """
import contextlib, io, json, sys
from palp_core.__main__ import main
done = []
for line in json.loads(sys.argv[1]):
    sys.argv = ["palp", *line.split()]
    with contextlib.redirect_stderr(io.StringIO()) as said:
        try:
            main()
        except SystemExit as end:
            done.append((end.code, said.getvalue()))
print(json.dumps(done))
"""
NEEDS = {
    "methods list": "rig",
    "devices list": "rig",
    "session report x": "rig",
    "emg analyse x.csv": "rig",
    "launch rig:sim.yaml --check": "rig",
    "view x": "view",
    "bridge foxglove": "foxglove",
}


def test_what_needs_more_says_in_one_line_what_to_install(base: dict[str, str], tmp_path: Path) -> None:
    done = said(base, tmp_path, ONE_AFTER_THE_OTHER, json.dumps(list(NEEDS)))
    assert done.returncode == 0, done.stderr
    for (line, extra), (status, told) in zip(NEEDS.items(), json.loads(done.stdout), strict=True):
        assert status == 2, line
        assert extras.install_line(extra) in told, line
        assert len(told.splitlines()) == 1, line
