"""A record in memory: palpations grouped into trials, what was learnt, and what is damaged."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.palpation.session.recorded_session import mm, read_session
from tests.support.sessions import Writer


def test_palpations_are_grouped_into_trials_with_their_outcome(record: Writer) -> None:
    trials = [(0, [[0.5, 0.25, 0.25], [1.0 + 2e-16, 0.0, 0.0]]), (2, [[0.1, 0.6, 0.3]])]
    found = read_session(record(trials=trials))
    assert [len(trial.probes) for trial in found.trials] == [2, 1]
    assert [trial.right for trial in found.trials] == [True, False]
    assert [trial.confidence for trial in found.trials] == [1.0, 0.6]  # rounding lifts none over 1
    assert found.tried_m == [0.002, 0.008]
    assert len(found.training) == 12
    assert {row.true_height_m for row in found.rows} == {None}  # nobody told
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
