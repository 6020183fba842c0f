"""No session is overwritten unasked; beside a folder that is named by its time a link leads to the latest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.palpation.session.session_folder import (
    OWN_FILES,
    REPLACED,
    RUN,
    TABLE,
    forget_replaced,
    link_latest,
    refuse_input,
    refuse_occupied,
    restore_replaced,
    take_over,
)
from palp_core.palpation.session.trials_csv import Row, SessionWriter, read_rows
from tests.palpation.session.test_trials_csv import FACTS


def wrote_one(folder: Path) -> SessionWriter:
    writer = SessionWriter(str(folder), (0.002, 0.004))
    writer.start()
    writer.append(Row(**FACTS), np.zeros(3), 1000.0)
    writer.close()
    return writer


def test_a_session_is_replaced_only_by_one_that_is_told_to(tmp_path: Path) -> None:
    wrote_one(tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    second = SessionWriter(str(tmp_path), (0.002, 0.004))
    with pytest.raises(
        PalpError, match=r"holds a session already \(trials.csv, sweeps\).*out:=NAME.*overwrite:=true"
    ):
        second.start()
    assert len(read_rows(tmp_path)) == 1
    second.start(overwrite=True)
    second.close()
    assert read_rows(tmp_path) == []
    assert not list((tmp_path / "sweeps").iterdir())
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize(
    "name", [name for name in OWN_FILES if name not in ("trials.csv", "sweeps", "run.json")]
)
def test_any_file_that_a_session_would_replace_is_in_its_way(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("of a study, say")
    with pytest.raises(PalpError, match=name):
        SessionWriter(str(tmp_path), (0.002,)).start()
    assert (tmp_path / name).read_text() == "of a study, say"


def test_a_session_that_ended_before_its_first_palpation_is_in_nobodys_way(tmp_path: Path) -> None:
    writer = SessionWriter(str(tmp_path), (0.002,))
    writer.start()
    (tmp_path / "run.json").write_text("{}")
    writer.close()
    refuse_occupied(tmp_path)
    writer.start()
    writer.close()


def test_latest_leads_to_the_last_folder_that_is_named_by_its_time(tmp_path: Path) -> None:
    for name in ("2026-11-22_21-05-09", "2026-11-22_21-05-10", "mine"):
        wrote_one(tmp_path / name)
    assert (tmp_path / "latest").readlink() == Path("2026-11-22_21-05-10")
    assert len(read_rows(tmp_path / "latest")) == 1


def test_a_folder_of_the_users_own_that_is_called_latest_stays(tmp_path: Path) -> None:
    (tmp_path / "latest").mkdir()
    wrote_one(tmp_path / "2026-11-22_21-05-09")
    assert not (tmp_path / "latest").is_symlink()
    link_latest(tmp_path / "2026-11-22_21-05-09")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["2026-11-22_21-05-09", "latest"]


def test_a_session_that_is_to_be_replaced_stays_until_the_other_has_a_row(tmp_path: Path) -> None:
    for name in (TABLE, RUN, "result.json"):
        (tmp_path / name).write_text("a\n1\n")
    (tmp_path / "mine.txt").write_text("mine")
    take_over(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [REPLACED, "mine.txt"]
    with pytest.raises(PalpError, match="holds a session already"):
        refuse_occupied(tmp_path)
    (tmp_path / TABLE).write_text("b\n")
    take_over(tmp_path)  # another one that ended before its first palpation
    restore_replaced(tmp_path)
    assert (tmp_path / TABLE).read_text() == "a\n1\n"
    assert not (tmp_path / REPLACED).exists()
    take_over(tmp_path)
    (tmp_path / TABLE).write_text("b\n2\n")
    forget_replaced(tmp_path)
    restore_replaced(tmp_path)
    assert (tmp_path / TABLE).read_text() == "b\n2\n"


def test_what_is_no_session_is_not_replaced_and_an_input_is_not_removed(tmp_path: Path) -> None:
    (tmp_path / "charts").mkdir()
    (tmp_path / "charts/thesis.png").write_text("x")
    (tmp_path / "noise.yaml").write_text("mine")
    with pytest.raises(PalpError, match="that is no session"):
        take_over(tmp_path)
    assert (tmp_path / "charts/thesis.png").exists()
    for name in ("noise.yaml", "sweeps/bag/bag_0.mcap"):
        with pytest.raises(PalpError, match=r"noise:=x is in .* move it elsewhere"):
            refuse_input(tmp_path, tmp_path / name, "noise:=x")
    refuse_input(tmp_path, tmp_path / "mine.yaml", "noise:=x")
