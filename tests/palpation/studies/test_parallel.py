"""Real processes: Ctrl-C, as a terminal sends it to a whole process group, and a killed parent."""

import contextlib
import importlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from palp_core.cli.rig.study import app
from palp_core.graph.clock import monotonic_ns
from palp_core.palpation.studies.catalogue import STUDIES, Study
from palp_core.palpation.studies.parallel import progress

PATIENCE_S = 240.0

TOY = """
import multiprocessing, os, threading
from dataclasses import dataclass
from pathlib import Path
from palp_core.palpation.studies.parallel import Runner

HERE = Path(os.environ["TOY"])
wait = threading.Event().wait
if multiprocessing.parent_process():
    (HERE / f"worker_{os.getpid()}").touch()
    if os.environ["TOY_DONE"] == "0":
        import numpy, scipy.signal  # what a worker is busy with when Ctrl-C comes early


@dataclass(frozen=True)
class Job:
    number: int


def work(job):
    with (HERE / "worked").open("a") as file:
        file.write(f"{job.number}\\n")
    if job.number >= int(os.environ["TOY_DONE"]):
        wait()
    return job.number**2


def run(out, *, quick, workers, dask):
    found = Runner(workers=workers, dask=dask).run_jobs(work, [Job(n) for n in range(6)], label="cells")
    page = out / "page"
    page.write_text(" ".join(map(str, found)))
    return page
"""
STUDY = Study("toy", "Does it stop?", "toy:run")
MAIN = (
    "from palp_core.cli.main import main; from palp_core.palpation.studies.catalogue import STUDIES, Study; "
    f"STUDIES['toy'] = {STUDY}; main()"
)

Start = Callable[..., subprocess.Popen[str]]
RunHere = Callable[[int], Result]


def wait_until(holds: Callable[[], object]) -> None:
    pause, end_ns = threading.Event(), monotonic_ns() + round(PATIENCE_S * 1e9)
    while not holds():
        assert monotonic_ns() < end_ns
        pause.wait(0.01)


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    started: list[int] = []
    (tmp_path / "toy.py").write_text(TOY, encoding="utf-8")

    def begin(done: int, workers: int = 2) -> subprocess.Popen[str]:
        path = os.pathsep.join([str(tmp_path), *sys.path])
        more = {"TOY": str(tmp_path), "TOY_DONE": str(done), "PYTHONPATH": path}
        command = [sys.executable, "-c", MAIN, "study", "run", "toy", "--out", str(tmp_path / "out")]
        process = subprocess.Popen(
            [*command, "--workers", str(workers)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env=os.environ | more,
        )
        started.append(process.pid)
        return process

    yield begin
    for group in started:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(group, signal.SIGKILL)


@pytest.fixture
def run_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[RunHere]:
    """Run the toy in this process: Ctrl-C comes where it would wait."""
    (tmp_path / "toy.py").write_text(TOY, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(STUDIES, "toy", STUDY)
    monkeypatch.setenv("TOY", str(tmp_path))

    def ctrl_c() -> None:
        raise KeyboardInterrupt

    importlib.import_module("toy").__dict__["wait"] = ctrl_c

    def run(done: int) -> Result:
        monkeypatch.setenv("TOY_DONE", str(done))
        return CliRunner().invoke(app, ["run", "toy", "--out", str(tmp_path / "out")])

    yield run
    del sys.modules["toy"]


def running(group: int) -> list[str]:
    """Processes of a group that still do something."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, its_group = stat.read_text(encoding="utf-8").rpartition(")")[2].split()[:3]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(its_group) == group and state not in "ZX":
            found.append(stat.parent.name)
    return found


def ended(process: subprocess.Popen[str], number: int) -> tuple[list[str], list[str]]:
    """Send a signal to the group; return the lines of standard output and error."""
    os.killpg(process.pid, number)
    said, errors = process.communicate(timeout=PATIENCE_S)
    wait_until(lambda: not running(process.pid))
    # progress is told where a loaded machine takes its time
    return said.splitlines(), [line for line in errors.splitlines() if " done, about " not in line]


def lines(file: Path) -> int:
    return len(file.read_text(encoding="utf-8").splitlines()) if file.exists() else 0


STOPPED = ["toy: Does it stop?", "toy stopped; nothing is kept"]


@pytest.mark.parametrize("done", [3, 0])
def test_ctrl_c_of_workers_is_quiet_and_leaves_none(start: Start, tmp_path: Path, done: int) -> None:
    process = start(done=done)
    if done:
        wait_until(lambda: lines(tmp_path / "worked") == done + 2)
    else:  # while they start
        wait_until(lambda: any(tmp_path.glob("worker_*")))
    said, errors = ended(process, signal.SIGINT)
    assert (process.returncode, said, errors) == (130, [], STOPPED)


def test_ctrl_c_of_a_study_without_workers_is_as_quiet(run_here: RunHere, tmp_path: Path) -> None:
    done = run_here(3)
    assert (done.exit_code, done.stdout, done.stderr.splitlines()) == (130, "", STOPPED)
    assert run_here(6).exit_code == 0
    assert (tmp_path / "out" / "page").read_text(encoding="utf-8") == "0 1 4 9 16 25"


def test_workers_do_not_outlive_a_killed_parent(start: Start, tmp_path: Path) -> None:
    process = start(done=0)
    wait_until(lambda: lines(tmp_path / "worked") == 2)
    process.kill()
    process.communicate(timeout=PATIENCE_S)
    wait_until(lambda: not running(process.pid))


def test_a_log_gets_a_line_now_and_then(capsys: pytest.CaptureFixture[str]) -> None:
    time_ns = 0
    with progress("cells", 6, now_ns=lambda: time_ns) as advance:
        for _ in range(6):
            time_ns += 8_000_000_000
            advance()
    assert capsys.readouterr().err.splitlines() == [
        "cells: 3 of 6 done, about 24 s to go",
        "cells: 6 of 6 done, about 0 s to go",
    ]
