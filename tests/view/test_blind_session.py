"""What the folder of a blinded session with a person shows before it is unsealed, wherever its key lies."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from palp_core.view.source.sealed import sealed_within

BLIND, OPEN = (f'{{"params": {{"session": {{"blind": {word}}}}}}}' for word in ("true", "false"))


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A session's folder; its key lies somewhere else."""
    folder = tmp_path / "study" / "S1" / "out"
    (folder / "bag").mkdir(parents=True)
    (folder / "run.json").write_text(BLIND, encoding="utf-8")
    return folder


def test_its_folder_and_all_around_it_is_sealed_until_its_key_is_opened(out: Path, tmp_path: Path) -> None:
    assert [sealed_within(folder) for folder in (tmp_path, out.parent, out, out / "bag")] == [out] * 4
    (out / "key.json").write_text("{}", encoding="utf-8")
    assert (sealed_within(out), sealed_within(tmp_path)) == (None, None)


def test_a_key_that_lies_there_unopened_seals_as_much(tmp_path: Path) -> None:
    (tmp_path / "stickers.sealed").touch()
    assert sealed_within(tmp_path) == tmp_path
    (tmp_path / "stickers.json").touch()
    assert sealed_within(tmp_path) is None


def test_an_open_session_next_to_it_is_shown_by_itself(out: Path) -> None:
    study = out.parents[1]
    (study / "open").mkdir()
    (study / "open" / "run.json").write_text(OPEN, encoding="utf-8")
    assert (sealed_within(study / "open"), sealed_within(study)) == (None, out)


NOTES = {"no JSON": "{", "no run": "[1]", "no nodes": '{"params": 3}', "odd nodes": '{"params": {"a": 4}}'}


@pytest.mark.parametrize("text", NOTES.values(), ids=NOTES)
def test_what_is_no_note_of_a_run_seals_nothing_and_breaks_nothing(text: str, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(text, encoding="utf-8")
    assert sealed_within(tmp_path) is None


def test_a_pipe_in_place_of_the_note_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "run.json")
    assert sealed_within(tmp_path) is None
