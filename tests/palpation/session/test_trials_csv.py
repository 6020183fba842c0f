"""A column of trials.csv is a field of ``Row``: written and read back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.palpation.session.trials_csv import Row, SessionWriter, read_rows, read_sweep

FACTS: dict[str, Any] = {
    "row": 0, "session": "s, \"quoted\"", "phase": "estimation", "phantom": "A", "remount": 2, "trial": 3,
    "depth_m": 0.002, "iteration": 4, "ring_m": 0.016, "true_ring_m": 0.0161, "true_height_m": -1e-5,
    "peak_n_m": 0.01, "posterior": [0.25, 0.75], "gain": [0.5, 0.125], "gamma": 0.5, "verdict": "decided",
    "estimate_m": 0.002, "outlier": True, "policy": "fixed", "seed": 7, "start_ns": 1, "end_ns": 2**60,
    "landed": False, "guards": ["lift-off; at last", "stuck, too"],
    "enter_ns": 3, "leave_ns": 2**61,
}  # fmt: skip
NOTHING: dict[str, Any] = {
    "row": 1, "posterior": [], "gain": [], "gamma": None, "estimate_m": None, "true_ring_m": None,
    "true_height_m": None, "outlier": False, "landed": False, "guards": [],
    "enter_ns": None, "leave_ns": None,
}  # fmt: skip


def test_every_column_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    assert set(FACTS) == set(Row.__struct_fields__)
    rows = [Row(**FACTS), Row(**(FACTS | NOTHING))]
    writer = SessionWriter(str(tmp_path / "out"), (0.002, 0.004))
    writer.start()
    for row in rows:
        writer.append(row, np.zeros(3), 1000.0)
    writer.close()
    assert read_rows(tmp_path / "out") == rows


def test_a_sweep_is_read_back_to_the_bit_and_by_numpy_itself(tmp_path: Path) -> None:
    torque_n_m = np.random.default_rng(1).standard_normal(4001)
    writer = SessionWriter(str(tmp_path), (0.002, 0.004))
    writer.start()
    writer.append(Row(**FACTS), torque_n_m, 1000.0)
    writer.close()
    read, rate_hz = read_sweep(tmp_path, 0)
    assert (read.tolist(), rate_hz) == (torque_n_m.tolist(), 1000.0)
    with np.load(tmp_path / "sweeps" / "000000.npz") as content:
        assert sorted(content) == ["rate_hz", "torque_n_m"]


def test_a_table_of_which_a_part_is_there_twice_is_refused_with_its_line(tmp_path: Path) -> None:
    writer = SessionWriter(str(tmp_path), (0.002, 0.004))
    writer.start()
    for number in range(3):
        writer.append(Row(**(FACTS | {"row": number})), np.zeros(3), 1000.0)
    writer.close()
    table = tmp_path / "trials.csv"
    lines = table.read_text(encoding="utf-8").splitlines(keepends=True)
    table.write_text("".join([*lines, *lines[1:]]), encoding="utf-8")
    with pytest.raises(PalpError, match=r"trials.csv:5: row 0 follows row 2: a part .* is there twice"):
        read_rows(tmp_path)
    table.write_text("".join([lines[0], lines[1], lines[3]]), encoding="utf-8")
    assert [row.row for row in read_rows(tmp_path)] == [0, 2]


def test_palpations_of_the_trial_under_way_are_set_aside_each_time_a_session_resumes(tmp_path: Path) -> None:
    writer = SessionWriter(str(tmp_path), (0.002, 0.004))
    writer.start()
    rows = [Row(**(FACTS | {"row": number})) for number in range(6)]
    for row in rows:
        writer.append(row, np.full(3, float(row.row)), 1000.0)
    writer.close()
    for count in (5, 2):
        resumed = SessionWriter(str(tmp_path), (0.002, 0.004))
        resumed.go_on(count)
        resumed.close()
    assert read_rows(tmp_path) == rows[:2]
    assert read_rows(tmp_path / "interrupted" / "1") == rows[5:]
    assert read_rows(tmp_path / "interrupted" / "2") == rows[2:5]
    assert [path.name for path in sorted((tmp_path / "sweeps").iterdir())] == ["000000.npz", "000001.npz"]
    assert read_sweep(tmp_path / "interrupted" / "2", 3)[0].tolist() == [3.0, 3.0, 3.0]
