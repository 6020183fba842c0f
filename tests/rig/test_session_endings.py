"""A session's folder at the end of its run, however that comes: whole, marked, never another's."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
from pathlib import Path

import msgspec
import pytest

from palp_core.counted import counted
from palp_core.errors import PalpError
from palp_core.graph.launch.checking import check_start
from palp_core.graph.messages.frame import topic_of
from palp_core.graph.supervision.interrupt import INSIST_NS, Interrupted
from palp_core.palpation.session.trials_csv import read_rows
from tests.support.palp import PATIENCE_S, SIM, Palp, wait_for_line
from tests.support.rig_session import ComposedGraph, RigSession, check_here
from tests.support.sessions import blank_charts

__all__ = ["blank_charts"]

LONG = ("trials:=40", "training:=25")


@pytest.fixture
def occupied(rig_session: RigSession, tmp_path: Path) -> Path:
    """A copy of a whole session."""
    return Path(shutil.copytree(rig_session.out, tmp_path / "out"))


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_a_second_launch_into_a_session_is_refused_before_anything_starts(occupied: Path) -> None:
    before = contents(occupied)
    with pytest.raises(PalpError) as refused:
        ComposedGraph(SIM, out=occupied, trials=1, training=1).__enter__()
    assert f"'{occupied}' holds a session already" in str(refused.value)
    assert "out:=NAME" in str(refused.value)
    assert "overwrite:=true" in str(refused.value)
    assert contents(occupied) == before


def test_the_check_says_what_only_a_start_would_say(palp: Palp, occupied: Path) -> None:
    before = contents(occupied)
    done = palp.here("launch", SIM, "--check", f"out:={occupied}")
    assert (done.returncode, "holds a session already" in done.stderr) == (2, True), done.stderr
    checked = check_here(SIM, [f"out:={occupied}", "overwrite:=true"])
    check_start(SIM, checked)
    with pytest.raises(PalpError, match="'a/b' is not a graph's name"):
        check_start(SIM, checked, "a/b")
    with pytest.raises(PalpError, match="nothing replaces '~' there"):
        check_start(SIM, msgspec.structs.replace(checked, args=checked.args | {"out": "~/session"}))
    assert contents(occupied) == before


def test_by_default_a_session_has_a_folder_named_by_its_time() -> None:
    checked = check_here(SIM)
    assert re.fullmatch(r"results/\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d", checked.args["out"])
    assert checked.args["overwrite"] is False


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A session that was interrupted after a palpation, and what was reported of it.

    Next to it, in ``killed``, is what a launcher leaves that is killed there.
    """
    out = tmp_path_factory.mktemp("interrupted") / "out"

    def observe(_: int, frame: bytes) -> None:
        if topic_of(frame) == b"/experiment/progress":
            shutil.copytree(out, out.with_name("killed"))
            signal.raise_signal(signal.SIGINT)

    graph = ComposedGraph(SIM, observe=observe, overrides=[f"out:={out}", *LONG])
    with pytest.raises(Interrupted), graph:
        graph.run()
    assert graph.summary is not None
    assert graph.summary.exit_code == 130
    return out, graph.summary.report


def test_a_session_that_is_interrupted_says_how_far_it_came_and_what_is_kept(
    interrupted: tuple[Path, str],
) -> None:
    out, shown = interrupted
    count = len(read_rows(out))
    words = f"nfinished: {count} of 375 palpations of training"
    assert f"U{words}, because: interrupted by SIGINT." in shown
    kept = f"Kept: {counted(count, 'palpation')} (trials.csv, sweeps/) and result.json in {out}. Report: "
    assert shown.splitlines()[-1] == f"{kept}{out}/report.html"
    assert f"(u{words})" in (out / "report.html").read_text()
    unfinished = json.loads((out / "result.json").read_text())["unfinished"]
    assert unfinished == {
        "done": count, "of": 375, "what": "palpations of training", "why": "interrupted by SIGINT",
    }  # fmt: skip


@pytest.mark.nightly
def test_who_asks_for_the_end_twice_gets_it_without_a_report_and_can_have_that_later(
    palp: Palp, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    process = palp.start("launch", SIM, f"out:={out}", *LONG)
    wait_for_line(process, "training: ")
    nodes = json.loads((next((palp.runtime_dir / "palp").glob("sim-*")) / "graph.json").read_text())["nodes"]
    emg = next(node["pid"] for node in nodes if node["name"] == "emg")
    os.kill(emg, signal.SIGSTOP)  # the end waits for it, unless somebody insists
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(INSIST_NS / 1e9 + 0.1)
    shown, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, errors
    assert (
        "No report was written: the end was asked for twice; `palp session report` makes it later." in shown
    )
    assert "interrupted by SIGINT; all nodes exited" in errors
    assert "Traceback" not in errors
    assert palp.all_gone()
    assert not (out / "report.html").exists()
    assert not list(out.glob("*.part"))
    done = palp.here("session", "report", out)
    assert done.returncode == 0, done.stderr
    assert f"nfinished: {len(read_rows(out))} of 375 palpations of training" in done.stdout
    assert (out / "report.html").exists()


@pytest.mark.usefixtures("blank_charts")
def test_the_report_of_a_killed_launcher_is_made_from_what_it_left(
    palp: Palp, interrupted: tuple[Path, str], tmp_path: Path
) -> None:
    moved = interrupted[0].with_name("killed").rename(tmp_path / "moved")
    assert not (moved / "report.html").exists()
    done = palp.here("session", "report", moved)
    assert done.returncode == 0, done.stderr
    assert "of 375 palpations of training, because: no end was reported." in done.stdout
    assert done.stdout.splitlines()[-1].endswith(f"Report: {moved}/report.html")
    none = palp.here("session", "report", tmp_path)
    assert (none.returncode, f"{tmp_path / 'run.json'}" in none.stderr) == (2, True)


def test_a_run_that_failed_before_its_session_began_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise PalpError("no such thing")

    monkeypatch.setattr("nodes.experiment.Experiment.on_activate", fail)
    graph = ComposedGraph(SIM, out=tmp_path / "out", trials=0, training=1)
    with pytest.raises(PalpError, match="no such thing"), graph:
        graph.run()
    assert graph.summary is not None
    assert graph.summary.report.startswith("Nothing is kept")
    assert not (tmp_path / "out").exists()
