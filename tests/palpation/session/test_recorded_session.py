"""A record in memory, what is damaged in it, and decisions about its trials, which every analysis honours."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from palp_core.cli.session import app
from palp_core.errors import PalpError
from palp_core.palpation.session.audit import AUDIT, decisions, left_out
from palp_core.palpation.session.recorded_session import mm, read_session
from palp_core.palpation.session.recorded_sweeps import read_sweeps
from palp_core.palpation.session.report import write
from palp_core.palpation.session.result import read_result
from palp_core.palpation.session.trials_csv import SessionWriter, read_rows
from tests.support.sessions import Summariser, Writer


def test_palpations_are_grouped_into_trials_with_their_outcome(record: Writer) -> None:
    trials = [(0, [[0.5, 0.25, 0.25], [1.0 + 2e-16, 0.0, 0.0]]), (2, [[0.1, 0.6, 0.3]])]
    found = read_session(record(trials=trials))
    assert [len(trial.probes) for trial in found.trials] == [2, 1]
    assert [trial.right for trial in found.trials] == [True, False]
    assert [trial.confidence for trial in found.trials] == [1.0, 0.6]  # rounding lifts none over 1
    assert found.tried_m == [0.002, 0.008]
    assert len(found.training) == 12
    assert {row.true_height_m for row in found.rows} == {None}  # it was not recorded
    expected = found.expected_depth_m(found.trials[0])  # from the flat prior on
    assert expected == pytest.approx(np.array([14 / 3, 4.0, 2.0]) * 1e-3)
    assert [mm(0.002), mm(0.0025), mm(0.0)] == ["2", "2.5", "0"]


def test_a_row_cut_short_leaves_its_trial_without_an_end(record: Writer) -> None:
    out = record(trials=[(0, [[0.9, 0.1, 0.0]]), (1, [[0.2, 0.8, 0.0], [0.1, 0.9, 0.0]])])
    table = out / "trials.csv"
    table.write_text(table.read_text()[:-20])
    found = read_session(out)
    assert (len(found.trials), found.unfinished_count) == (1, 1)


@pytest.mark.parametrize(
    "garbage",
    ["", "{", "null", "[]", "3", '{"depths_m": []}', "\x00", "[" * 100_000, '{"mean": [["x"]]}'],
)
def test_primitives_that_cannot_be_read_are_an_error_and_fitted_again_without_them(
    record: Writer, garbage: str
) -> None:
    file = record() / "primitives.json"
    if "mean" in garbage:
        garbage = json.dumps(json.loads(file.read_text()) | json.loads(garbage))
    file.write_text(garbage)
    with pytest.raises(
        PalpError, match=r"primitives\.json cannot be read: .*; remove it, and it is fitted again"
    ):
        read_session(file.parent)
    file.unlink()
    assert read_session(file.parent).primitives is not None


def test_training_that_did_not_reach_every_cell_gives_no_primitives(record: Writer) -> None:
    out = record(primitives=False)
    whole = read_session(out).primitives
    assert whole is not None
    assert whole.mean.shape == (3, 2)
    lines = (out / "trials.csv").read_text().splitlines(keepends=True)
    (out / "trials.csv").write_text("".join(lines[:7]))
    found = read_session(out)
    assert found.primitives is None
    assert (len(found.training), found.trials) == (6, ())


def test_a_table_without_a_row_is_an_empty_session(record: Writer) -> None:
    found = read_session(record(repeats=0))
    assert (found.rows, found.primitives) == ((), None)
    assert found.depths_m == (0.002, 0.004, 0.008)


def test_a_damaged_posterior_and_a_folder_without_a_record_are_named(record: Writer, tmp_path: Path) -> None:
    with pytest.raises(PalpError, match="row 0 has a posterior of 2, not 3"):
        read_session(record(repeats=0, trials=[(0, [[0.9, 0.1]])]))
    with pytest.raises(PalpError, match="no record"):
        read_session(tmp_path)


SURE = [(0.9, 0.05, 0.05)]
pytestmark = pytest.mark.usefixtures("blank_charts")


def palp(*words: object) -> str:
    done = CliRunner().invoke(app, [str(word) for word in words])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.stdout


@pytest.fixture
def session(record: Writer) -> Path:
    """Three trials of 2 mm, of which the last is wrong."""
    return record(trials=[(0, SURE), (0, SURE), (1, SURE)])


def test_what_is_excluded_or_to_be_done_again_counts_nowhere_and_is_still_there(
    session: Path, summary: Summariser
) -> None:
    write(session, summary(session))
    assert "left_out" not in (session / "result.json").read_text()
    before = (session / "trials.csv").read_bytes()
    palp("exclude", 1002, session, "--reason", "the phantom slipped")
    first = (session / AUDIT).read_bytes()
    palp("redo", 1, session, "--training", "--reason", "the  gel was\ntouched")
    assert (session / AUDIT).read_bytes().startswith(first)
    assert [one.deed for one in decisions(session)] == ["exclude", "redo"]
    assert left_out(session) == {
        ("estimation", 1002): "exclude: the phantom slipped",
        ("training", 1): "redo: the gel was touched",
    }
    assert (session / "trials.csv").read_bytes() == before
    assert [trial.right for trial in read_session(session).trials] == [True, True]
    sweeps = {(sweep.phase, sweep.trial) for sweep in read_sweeps(session).sweeps}
    every = {(row.phase, row.trial) for row in read_rows(session)}
    assert every - sweeps == {("training", 1), ("estimation", 1002)}
    write(session, summary(session))
    result = read_result(session)
    assert result.accuracy.overall.right == 2
    assert result.left_out == {
        "estimation 1002": "exclude: the phantom slipped",
        "training 1": "redo: the gel was touched",
    }
    assert "the phantom slipped" in (session / "report.html").read_text()


def test_a_trial_that_is_not_there_or_has_no_reason_is_refused(session: Path) -> None:
    with pytest.raises(PalpError, match="has no estimation trial 7000; there are 1000 to 1002"):
        palp("exclude", 7000, session, "--reason", "never")
    with pytest.raises(PalpError, match="needs its reason"):
        palp("exclude", 1000, session, "--reason", " ")
    for reason in ("\x1b[31mred", "\udcff", "\u202eback", "x" * 2000):
        with pytest.raises(PalpError, match="cannot be printed, or more than 1000"):
            palp("exclude", 1000, session, "--reason", reason)
    assert not (session / AUDIT).exists()


def test_another_session_in_the_folder_does_not_inherit_them(session: Path, tmp_path: Path) -> None:
    copied = Path(shutil.copytree(session, tmp_path / "copied"))  # whose lock no one holds
    palp("exclude", 1000, copied, "--reason", "of the first")
    writer = SessionWriter(str(copied), (0.002,))
    writer.start(overwrite=True)
    writer.close()
    assert left_out(copied) == {}


DAMAGED: dict[str, Callable[[Path], object]] = {
    "a pipe": os.mkfifo,
    "a folder": Path.mkdir,
    "half a line": lambda path: path.write_text("phase,trial,deed,reason,time,user\nestimation,1,excl"),
    "another heading": lambda path: path.write_text("trial,deed\n1,exclude\n"),
    "a cell too long": lambda path: path.write_text(
        f"phase,trial,deed,reason,time,user\nestimation,1,redo,{'x' * 200_000},t,u\n"
    ),
}


@pytest.mark.parametrize("how", DAMAGED)
def test_to_a_damaged_audit_nothing_is_appended(session: Path, how: str) -> None:
    DAMAGED[how](session / AUDIT)
    with pytest.raises(PalpError, match=r"audit.csv( cannot be read: it is a|:\d: the line is damaged)"):
        palp("exclude", 1000, session, "--reason", "slipped")
