"""Every example runs with its one command, and shows what its row says."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.palp import PATIENCE_S, ROOT, Palp

EXAMPLES = ROOT / "examples"
ROW = re.compile(r"\| `(?P<place>[\w/.]+)` \| [^|]+ \| (?P<command>[^|]+) \|")


def run(palp: Palp, cwd: Path, *words: object, **also: str) -> subprocess.CompletedProcess[str]:
    environment = palp.environment | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHON": sys.executable,
        "MPLBACKEND": "Agg",
        **also,
    }
    done = subprocess.run(
        [str(word) for word in words], cwd=cwd, env=environment, capture_output=True, text=True,
        timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert palp.all_gone(), "it left a process behind"
    return done


def test_every_example_has_its_row_and_every_row_its_example() -> None:
    rows = {
        found["place"].rstrip("/"): found["command"]
        for found in ROW.finditer((EXAMPLES / "README.md").read_text())
    }
    there = {path.name for path in EXAMPLES.iterdir() if path.is_dir() and path.name != "notebooks"}
    there |= {f"notebooks/{path.name}" for path in (EXAMPLES / "notebooks").glob("*.ipynb")}
    assert rows.keys() == there
    for command in rows.values():
        for word in re.findall(r"examples/[\w/.]+", command):
            assert (ROOT / word).exists(), command


def angles(folder: Path, from_s: float, to_s: float) -> list[tuple[float, float]]:
    """Return what was asked for and what came, between two times."""
    with (folder / "pendulum.csv").open(encoding="utf-8") as file:
        rows = [tuple(map(float, row)) for row in list(csv.reader(file))[1:]]
    return [(asked, came) for time_s, asked, came in rows if from_s < time_s <= to_s]


@pytest.mark.parametrize("picture", [False, pytest.param(True, marks=pytest.mark.nightly)])
def test_a_pendulum_is_held_beside_and_after_the_swap_on_what_is_asked_for(
    picture: bool, palp: Palp, tmp_path: Path
) -> None:
    """Without a picture where matplotlib is not installed: to import it takes as long as all the rest."""
    paths = palp.environment["PYTHONPATH"]
    if not picture:
        (tmp_path / "matplotlib.py").write_text("raise ModuleNotFoundError", encoding="utf-8")
        paths = f"{tmp_path}{os.pathsep}{paths}"
    done = run(palp, tmp_path, sys.executable, EXAMPLES / "pendulum" / "swap.py", "out", PYTHONPATH=paths)
    assert done.returncode == 0, done.stderr
    before, after = (angles(tmp_path / "out", *span) for span in ((3.5, 4.0), (7.5, 8.0)))
    assert all(came - asked > 0.05 for asked, came in before)
    assert all(abs(came - asked) < 0.02 for asked, came in after)
    assert (tmp_path / "out" / "pendulum.png").exists() is picture


def test_a_driver_of_a_lab_tares_tells_of_loss_and_of_silence_and_recovers(
    palp: Palp, tmp_path: Path
) -> None:
    done = run(palp, tmp_path, sys.executable, EXAMPLES / "driver" / "try_it.py")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "500 samples and more, 1.5 N mm",
        "tared, then loaded: 30.0 N mm",
        "50 samples left out: a gap",
        "health: stale",
        "health: ok",
    ]


@pytest.mark.nightly
def test_clients_of_few_lines_read_publish_and_call(palp: Palp, tmp_path: Path) -> None:
    done = run(palp, tmp_path, EXAMPLES / "interop" / "run.sh")
    assert done.returncode == 0, done.stderr
    assert '"torque_n_m": [0.2, 0.2, 0.2, 0.2, 0.2, 0.2]' in done.stdout
    assert '"torque_n_m": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]' in done.stdout.splitlines()[-1]


@pytest.mark.nightly
def test_a_node_of_another_host_misses_nothing_once_it_has_joined(palp: Palp, tmp_path: Path) -> None:
    if shutil.which("ip") is None:
        pytest.skip("no command ip here")
    may = subprocess.run(
        ["ip", "netns", "add", f"may-{os.getpid()}"], capture_output=True, text=True, check=False
    )
    if may.returncode:
        pytest.skip(f"no network namespaces here: {may.stderr.strip()}")
    subprocess.run(["ip", "netns", "delete", f"may-{os.getpid()}"], check=True)
    done = run(palp, tmp_path, EXAMPLES / "two_hosts" / "run.sh", tmp_path / "out")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "heard 200; missing: 0" in done.stdout
    blocks = json.loads((tmp_path / "out" / "heard.json").read_text())
    assert blocks == list(range(blocks[0], blocks[0] + 200))


PRINT = """
import json, sys
for cell in json.load(open(sys.argv[1]))["cells"]:
    if cell["cell_type"] == "code":
        print("CELL", flush=True)
        exec("".join(cell["source"]), globals())
"""


def printed(cell: dict[str, Any]) -> str:
    return "".join("".join(one["text"]) for one in cell["outputs"] if one["output_type"] == "stream")


@pytest.mark.nightly
@pytest.mark.parametrize(
    "notebook", sorted((EXAMPLES / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem
)
def test_a_notebook_says_what_it_says_when_it_is_run_again(notebook: Path, palp: Palp) -> None:
    """Word for word, so that what a reader sees without running it is what he would get."""
    done = run(palp, notebook.parent, sys.executable, "-c", PRINT, notebook)
    assert done.returncode == 0, done.stderr
    cells = [cell for cell in json.loads(notebook.read_text())["cells"] if cell["cell_type"] == "code"]
    assert done.stdout.split("CELL\n")[1:] == [printed(cell) for cell in cells]
    assert any("image/png" in output.get("data", {}) for cell in cells for output in cell["outputs"])
