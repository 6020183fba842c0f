"""The experiment resumes with devices that have started again, and repeats what is marked: once each."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from msgs.experiment import Mount, Trial
from nodes.experiment import Experiment
from palp_core import Bench
from palp_core.cli.session import app
from palp_core.errors import NodeError
from palp_core.palpation.session.audit import AUDIT, decide, decisions, left_out
from palp_core.palpation.session.human.record import read_human
from palp_core.palpation.session.recorded_session import read_session
from palp_core.palpation.session.session_folder import RUN
from palp_core.palpation.session.trials_csv import Row, read_rows, read_sweep
from palp_core.whole_file import write_json
from tests.nodes.human.test_human_session import Lab
from tests.nodes.test_experiment import Rig, params_in, run
from tests.palpation.session.test_trials_csv import full_after
from tests.support.kept import Kept, go_on, require_each_row_once
from tests.support.sessions import describe, writer


def interrupted(out: Path, steps: int, **params: object) -> tuple[Bench[Experiment], bytes]:
    """Run so many requests; return the experiment, and what was kept of it as the last trial began."""
    bench = Bench(Experiment, params_in(out, **params))
    kept, rig = Kept(bench, "/node/trial"), Rig(bench)
    for _ in range(steps):
        rig.run(1)
        kept.turn()
    bench.node.record.close()  # as the end of its process does
    return bench, kept.node


def resumed(out: Path, kept: bytes, **params: object) -> Rig:
    return Rig(go_on(Experiment, params_in(out, **params), kept))


def trials_of(rows: list[Row]) -> dict[int, tuple[str, str, int]]:
    """Return phase, phantom and number of palpations of each trial."""
    counts = Counter(row.trial for row in rows)
    return {row.trial: (row.phase, row.phantom, counts[row.trial]) for row in rows}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Row]]:
    """What a session keeps that is not interrupted, by when the ring is re-homed."""
    folders = {mode: tmp_path_factory.mktemp(mode) for mode in ("trial", "never")}
    return {mode: read_rows(run(out, rehome=mode).bench.node.record.folder) for mode, out in folders.items()}


@pytest.mark.parametrize(
    ("mode", "steps"),
    [
        *(("trial", steps) for steps in (3, 4, 5, 6, 7, 60, 121, 128, 131, 136)),
        *(("never", steps) for steps in (3, 4, 5, 60, 128)),
    ],
)
def test_no_trial_is_lost_or_there_twice(
    steps: int, mode: str, whole: dict[str, list[Row]], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    _, kept = interrupted(out, steps, rehome=mode)
    before = read_rows(out)
    rig = resumed(out, kept, rehome=mode)
    rig.run()
    assert rig.bench.executor.exit_code == 0
    rows = read_rows(out)
    assert trials_of(rows) == trials_of(whole[mode])
    require_each_row_once(out, before, read_rows)
    assert all(len(read_sweep(out, row.row)[0]) for row in rows)
    assert sum(row.verdict not in ("", "continue") for row in rows) == 6


def test_the_phantom_is_put_on_again_and_the_trial_begun_again(tmp_path: Path) -> None:
    first, kept = interrupted(tmp_path, 128)
    state = first.node.state
    assert state.phase == "estimation"
    rig = resumed(tmp_path, kept)
    rig.run(3)
    mount, home, trial = rig.asked
    assert isinstance(mount, Mount)
    assert (mount.code, mount.remount) == (state.code, state.remount + 1)
    assert getattr(home, "rehome", False)
    assert isinstance(trial, Trial)
    assert (trial.trial, trial.phase) == (state.trial, "estimation")


def test_what_measures_a_rig_that_is_not_touched_cannot_go_on(tmp_path: Path) -> None:
    _, kept = interrupted(tmp_path, 6, plan="repeatability", trials=0, training=1)
    table = (tmp_path / "trials.csv").read_bytes()
    with pytest.raises(NodeError, match="devices that have started again; start it again, too"):
        resumed(tmp_path, kept, plan="repeatability", trials=0, training=1)
    assert (tmp_path / "trials.csv").read_bytes() == table


def test_a_table_that_lacks_palpations_is_refused(tmp_path: Path) -> None:
    _, kept = interrupted(tmp_path, 60)
    table = tmp_path / "trials.csv"
    lines = table.read_bytes().splitlines(keepends=True)
    table.write_bytes(b"".join(lines[:5]))
    with pytest.raises(NodeError, match=r"it has 4 palpations, and the session had come to \d+; restore"):
        resumed(tmp_path, kept)
    assert table.read_bytes() == b"".join(lines[:5])
    table.write_bytes(b"".join(lines))
    rig = resumed(tmp_path, kept)  # the refusal has cost nothing
    rig.run()
    assert rig.bench.executor.exit_code == 0


def test_what_cannot_be_written_stops_the_session_and_costs_nothing(
    whole: dict[str, list[Row]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    _, kept = interrupted(out, 60)
    rig = resumed(out, kept)
    count = len(read_rows(out))
    room = 3 * max(map(len, (out / "trials.csv").read_bytes().splitlines()))
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full_after(room))
        with pytest.raises(NodeError, match="No space left on device; the") as refused:
            rig.run()
    rows = read_rows(out)
    assert len(rows) > count
    assert f"palpation {len(rows) + 1} cannot be written to '{out}'" in str(refused.value)
    assert f"the {len(rows)} palpations before are kept there" in str(refused.value)
    assert all(len(read_sweep(out, row.row)[0]) for row in rows)
    rig.bench.node.record.close()
    resumed(out, kept).run()
    assert trials_of(read_rows(out)) == trials_of(whole["trial"])


PLANNED = 6  # trials of estimation of the small session


def ended(out: Path) -> list[Row]:
    """Return the last palpation of each trial of estimation that is over."""
    return [row for row in read_rows(out) if row.verdict not in ("", "continue")]


def run_until(rig: Rig, out: Path, count: int, kept: Kept | None = None) -> None:
    """Go on until so many trials of estimation are over."""
    while len(ended(out)) < count:
        rig.run(1)
        if kept is not None:
            kept.turn()


def test_a_trial_marked_while_the_session_goes_on_is_done_again_at_its_end(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rig = Rig(Bench(Experiment, params_in(tmp_path)))
    run_until(rig, tmp_path, 2)
    first = ended(tmp_path)[0]
    decide(tmp_path, ("estimation", first.trial), "redo", "the phantom slipped")
    decide(tmp_path, ("training", 1), "redo", "and in training")
    rig.run()
    assert rig.bench.executor.exit_code == 0
    last = ended(tmp_path)[-1]
    assert [row.trial for row in ended(tmp_path)] == list(range(1, PLANNED + 2))
    assert (last.trial, last.phantom, last.depth_m) == (PLANNED + 1, first.phantom, first.depth_m)
    assert last.remount == ended(tmp_path)[-2].remount + 1
    why = left_out(tmp_path)
    assert why["estimation", first.trial] == f"redo: the phantom slipped; done again as trial {PLANNED + 1}"
    assert why["training", 1] == "redo: and in training"
    assert "training trial 1 is marked and not repeated: only trials of estimation are" in caplog.text
    counted = [trial.probes[0].trial for trial in read_session(tmp_path).trials]
    assert counted == [n for n in range(1, PLANNED + 2) if n != first.trial]
    progress = rig.bench.sent(Experiment.progress)[-1]
    assert (progress.done_count, progress.total_count) == (7, 7)


def test_what_was_done_again_may_be_marked_again(tmp_path: Path) -> None:
    rig = Rig(Bench(Experiment, params_in(tmp_path)))
    run_until(rig, tmp_path, 1)
    decide(tmp_path, ("estimation", 1), "redo", "once")
    run_until(rig, tmp_path, 5)
    decide(tmp_path, ("estimation", 2), "redo", "another")
    rig.run()
    assert [row.trial for row in ended(tmp_path)] == list(range(1, PLANNED + 3))
    assert [(one.trial, one.deed) for one in decisions(tmp_path)[-2:]] == [(1, "redone"), (2, "redone")]


def test_an_interrupted_session_does_it_again_once(tmp_path: Path) -> None:
    """Interrupted after the mark was seen, and within the trial that is done again."""
    for stop in (3, 6):
        out = tmp_path / str(stop)
        rig = Rig(Bench(Experiment, params_in(out)))
        kept = Kept(rig.bench, "/node/trial")
        run_until(rig, out, 1, kept)
        decide(out, ("estimation", 1), "redo", "slipped")
        run_until(rig, out, stop, kept)
        for _ in range(3):
            rig.run(1)
            kept.turn()
        rig.bench.node.record.close()  # as the end of its process does
        resumed(out, kept.node).run()
        assert [row.trial for row in ended(out)] == list(range(1, PLANNED + 2))
        assert [one.deed for one in decisions(out)] == ["redo", "redone"]


def test_a_damaged_audit_does_not_end_the_session(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig(Bench(Experiment, params_in(tmp_path)))
    run_until(rig, tmp_path, 1)
    (tmp_path / AUDIT).write_text("trial,deed\n30,of old\n")
    rig.run()
    assert rig.bench.executor.exit_code == 0
    assert "nothing is repeated" in caplog.text


def test_a_trial_by_hand_is_done_again_at_the_end(tmp_path: Path) -> None:
    lab = Lab(tmp_path / "out")
    lab.calibrate()
    for _ in range(3):
        lab.trial()
    for number in range(3):
        lab.trial()
        if number == 2:
            decide(lab.out, ("estimation", 1), "redo", "the subject looked")
        assert lab.say("4").taken
    assert lab.prompt.text.startswith("Estimation trial 4 of 4. ")
    lab.trial()
    assert lab.say("8").taken
    assert "over" in lab.prompt.text
    rows = read_human(lab.out)
    assert [row.trial for row in rows] == [1, 2, 3, 1, 2, 3, 4]
    assert (rows[6].phantom, rows[6].phase, rows[6].trial) == (rows[3].phantom, "estimation", 4)
    assert left_out(lab.out) == {("estimation", 1): "redo: the subject looked; done again as trial 4"}


@pytest.mark.parametrize(("exit_code", "words"), [(-1, "repeats it at the end"), (0, "does not repeat it")])
def test_who_marks_a_trial_reads_whether_it_is_done_again(exit_code: int, words: str, tmp_path: Path) -> None:
    out = writer(tmp_path)(trials=[(0, [(0.9, 0.05, 0.05)])])
    write_json(out / RUN, msgspec.structs.replace(describe(out), exit_code=exit_code))
    done = CliRunner().invoke(app, ["redo", "1000", str(out), "--reason", "slipped"])
    assert words in done.output
