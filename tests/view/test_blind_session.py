"""What the folder of a blinded session with a person shows before it is unsealed, wherever its key lies."""

from __future__ import annotations

import os
from contextlib import closing
from pathlib import Path

import pytest

from palp_core.view.source.results import ResultsSource
from tests.support.palp import Palp
from tests.support.view.browser import address_of
from tests.support.view.page_socket import PageServer, PageSocket

BLIND, OPEN = (f'{{"params": {{"session": {{"blind": {word}}}}}}}' for word in ("true", "false"))
TABLE = "human_trials.csv"


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A session's folder; its key lies somewhere else."""
    folder = tmp_path / "study" / "S1" / "out"
    (folder / "bag").mkdir(parents=True)
    for path, text in (("run.json", BLIND), (TABLE, "row,phantom\n0,K7\n"), ("bag/metadata.yaml", "a: 1\n")):
        (folder / path).write_text(text, encoding="utf-8")
    return folder


def test_of_its_folder_and_all_around_it_nothing_is_shown_before_it_is_unsealed(
    out: Path, tmp_path: Path
) -> None:
    for folder in (tmp_path, out.parent, out, out / "bag"):
        source = ResultsSource(folder)
        assert (source.files(), source.path_of(TABLE), source.path_of("run.json")) == ([], None, None)
        (trouble,) = source.overview().troubles
        assert f"palp session unseal {out}" in trouble.advice
    (out / "key.json").write_text("{}", encoding="utf-8")
    assert TABLE in [file.name for file in ResultsSource(out).files()]
    assert ResultsSource(tmp_path).overview().troubles == []


def test_a_key_that_lies_there_unopened_hides_as_much(tmp_path: Path) -> None:
    (tmp_path / "stickers.sealed").touch()
    (tmp_path / TABLE).touch()
    assert ResultsSource(tmp_path).files() == []
    (tmp_path / "stickers.json").touch()
    assert TABLE in [file.name for file in ResultsSource(tmp_path).files()]


def test_a_session_in_the_open_next_to_it_is_shown_by_itself(out: Path) -> None:
    study = out.parents[1]
    (study / "open").mkdir()
    (study / "open" / "run.json").write_text(OPEN, encoding="utf-8")
    assert [file.name for file in ResultsSource(study / "open").files()] == ["run.json"]
    assert ResultsSource(study).files() == []


NOTES = {"no JSON": "{", "no run": "[1]", "no nodes": '{"params": 3}', "odd nodes": '{"params": {"a": 4}}'}


@pytest.mark.parametrize("text", NOTES.values(), ids=NOTES)
def test_what_is_no_note_of_a_run_hides_nothing_and_breaks_nothing(text: str, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(text, encoding="utf-8")
    assert [file.name for file in ResultsSource(tmp_path).files()] == ["run.json"]


def test_a_pipe_in_place_of_the_note_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "run.json")
    (tmp_path / "report.html").touch()
    assert [file.name for file in ResultsSource(tmp_path).files()] == ["report.html"]


def test_nothing_that_the_page_of_its_folder_is_sent_is_of_its_table(out: Path, shared_palp: Palp) -> None:
    server = PageServer(address_of(shared_palp.start("view", out, "--no-browser")))
    said = server.ask(f"/{server.token}/").body.decode()
    with closing(PageSocket(server)) as page:
        page.says("it is sealed")
        assert not any(TABLE in one or "K7" in one for one in (said, *page.received))
    assert server.ask(f"/{server.token}/files/{TABLE}").status == 404
