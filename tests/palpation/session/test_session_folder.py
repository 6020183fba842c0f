"""No session is overwritten unasked; beside a folder that is named by its time a link leads to the latest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.palpation.session.session_folder import OWN_FILES, link_latest, refuse_occupied
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
