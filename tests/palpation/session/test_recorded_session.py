from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.palpation.session.recorded_session import mm, read_session

Writer = Callable[..., Path]


def test_palpations_are_grouped_into_trials_with_their_outcome(record: Writer) -> None:
    found = read_session(record(trials=[(0, [[0.5, 0.3, 0.2], [0.9, 0.1, 0.0]]), (2, [[0.1, 0.6, 0.3]])]))
    assert [len(trial.probes) for trial in found.trials] == [2, 1]
    assert [trial.right for trial in found.trials] == [True, False]
    assert [trial.confidence for trial in found.trials] == [0.9, 0.6]
    assert found.tried_m == [0.002, 0.008]
    assert len(found.training) == 12


def test_the_expected_depth_starts_from_the_flat_prior(record: Writer) -> None:
    found = read_session(record(trials=[(0, [[0.5, 0.25, 0.25], [1.0, 0.0, 0.0]])]))
    expected = found.expected_depth_m(found.trials[0])
    assert expected == pytest.approx(np.array([14 / 3, 4.0, 2.0]) * 1e-3)


def test_a_confidence_that_rounding_lifted_over_one_is_one(record: Writer) -> None:
    found = read_session(record(trials=[(0, [[1.0 + 2e-16, 0.0, 0.0]])]))
    assert found.trials[0].confidence == 1.0


def test_a_row_cut_short_leaves_its_trial_without_an_end(record: Writer) -> None:
    out = record(trials=[(0, [[0.9, 0.1, 0.0]]), (1, [[0.2, 0.8, 0.0], [0.1, 0.9, 0.0]])])
    table = out / "trials.csv"
    table.write_text(table.read_text()[:-20])
    found = read_session(out)
    assert len(found.trials) == 1
    assert found.unfinished_count == 1


def test_a_session_that_ended_in_training_has_the_primitives_of_what_it_trained(record: Writer) -> None:
    found = read_session(record(primitives=False))
    assert found.primitives is not None
    assert found.primitives.mean.shape == (3, 2)
    assert found.trials == ()


@pytest.mark.parametrize("garbage", ["", "{", "null", "[]", "3", '{"depths_m": []}', "\x00", "[" * 100_000])
def test_primitives_that_cannot_be_read_are_an_error_and_fitted_again_without_them(
    record: Writer, garbage: str
) -> None:
    out = record()
    (out / "primitives.json").write_text(garbage)
    with pytest.raises(
        PalpError, match=r"primitives\.json cannot be read: .*; remove it, and it is fitted again"
    ):
        read_session(out)
    (out / "primitives.json").unlink()
    assert read_session(out).primitives is not None


def test_primitives_whose_values_are_no_numbers_are_an_error(record: Writer) -> None:
    file = record() / "primitives.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"mean": [["x"]]}))
    with pytest.raises(PalpError, match=r"primitives\.json cannot be read"):
        read_session(file.parent)


def test_training_that_did_not_reach_every_cell_gives_no_primitives(record: Writer) -> None:
    out = record(primitives=False)
    lines = (out / "trials.csv").read_text().splitlines(keepends=True)
    (out / "trials.csv").write_text("".join(lines[:7]))
    found = read_session(out)
    assert found.primitives is None
    assert len(found.training) == 6


def test_without_any_training_there_are_no_primitives(record: Writer) -> None:
    assert read_session(record(repeats=0)).primitives is None


def test_a_table_without_a_row_is_an_empty_session(record: Writer) -> None:
    found = read_session(record(repeats=0))
    assert found.rows == ()
    assert found.depths_m == (0.002, 0.004, 0.008)


def test_a_damaged_posterior_is_an_error_that_names_the_row(record: Writer) -> None:
    out = record(repeats=0, trials=[(0, [[0.9, 0.1]])])
    with pytest.raises(PalpError, match="row 0 has a posterior of 2, not 3"):
        read_session(out)


def test_a_folder_without_a_record_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(PalpError, match="no record"):
        read_session(tmp_path)


def test_lengths_are_written_as_people_write_them() -> None:
    assert [mm(0.002), mm(0.0025), mm(0.0)] == ["2", "2.5", "0"]
