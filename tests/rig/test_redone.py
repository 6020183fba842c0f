"""What is marked to be done again is done again at the session's end, and counts in place of the first."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from nodes.experiment import Experiment
from palp_core import Bench
from palp_core.cli.session import app
from palp_core.palpation.session.audit import AUDIT, decide, decisions, left_out
from palp_core.palpation.session.human.record import read_human
from palp_core.palpation.session.recorded_session import read_session
from palp_core.palpation.session.session_folder import RUN
from palp_core.palpation.session.trials_csv import Row, read_rows
from palp_core.whole_file import write_json
from tests.nodes.human.test_human_session import Lab
from tests.nodes.test_experiment import Rig, params_in
from tests.rig.test_experiment_resumed import resumed
from tests.support.kept import Kept
from tests.support.sessions import describe, writer

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
def test_who_marks_a_trial_is_told_whether_it_is_done_again(
    exit_code: int, words: str, tmp_path: Path
) -> None:
    out = writer(tmp_path)(trials=[(0, [(0.9, 0.05, 0.05)])])
    write_json(out / RUN, msgspec.structs.replace(describe(out), exit_code=exit_code))
    done = CliRunner().invoke(app, ["redo", "1000", str(out), "--reason", "slipped"])
    assert words in done.output
