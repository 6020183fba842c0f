"""The index tells of each study what was asked, what came out, when and how; it invents nothing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from palp_core.cli.rig.study import app
from palp_core.errors import PalpError
from palp_core.palpation.reporting.charts import Chart
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.studies import catalogue
from palp_core.palpation.studies.catalogue import STUDIES, Study
from palp_core.palpation.studies.index import StudyNote, write_index, write_note
from tests.palpation.reporting.page_flaws import flaws


def run_of_why(out: Path, *, quick: bool = False, workers: int = 1, dask: str = "") -> Path:
    """Write a page as the study ``why`` does, without its work."""
    chart = Chart("why", "Which suffice?", "", 2.0, ("share",), [(0.5,)], lambda figure: None)
    cell = {
        **dict.fromkeys(("accuracy", "low", "high", "progress", "progress_low", "progress_high"), 0.5),
        **{"cell": "none", "probes": 2.0, "ece": 0.1},
    }
    return write_page(
        out / "index.html",
        "studies/why.html",
        cells=[cell],
        near=["H1 & H2"],
        together=cell,
        hypotheses={"H1": "one"},
        picture=picture(chart, out),
        probe_count=3,
        control={},
        grid=[],
    )


@pytest.fixture
def ran(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder in which the study ``why`` was run by the command line."""
    monkeypatch.setattr(
        catalogue,
        "STUDIES",
        STUDIES | {"why": Study("why", STUDIES["why"].question, f"{__name__}:run_of_why", picture="why")},
    )
    monkeypatch.setattr("palp_core.palpation.studies.catalogue.study", lambda name: catalogue.STUDIES[name])
    done = CliRunner().invoke(
        app, ["run", "why", "--out", str(tmp_path / "my why"), "--quick", "--workers", "2"]
    )
    assert done.exit_code == 0, done.output
    return tmp_path


def test_a_run_leaves_a_note_that_runs_it_again(ran: Path) -> None:
    note = json.loads((ran / "my why" / "study.json").read_text("utf-8"))
    assert note["command"] == f"palp study run why --out '{ran}/my why' --quick --workers 2"
    assert note["quick"] is True
    assert len(note["date"].split("-")) == 3


def test_the_index_has_picture_question_answer_date_and_command(ran: Path) -> None:
    done = CliRunner().invoke(app, ["index", str(ran)])
    assert done.output.strip() == str(ran / "index.html")
    text = (ran / "index.html").read_text("utf-8")
    note = json.loads((ran / "my why" / "study.json").read_text("utf-8"))
    assert STUDIES["why"].question in text
    assert "Hypotheses whose interval, alone, holds the published 66.7 %: H1 &amp; H2." in text
    assert "Run with --quick: no result." in text
    assert note["date"] in text
    assert note["command"].replace("'", "&#39;") in text
    assert 'src="my%20why/why.png"' in text
    assert 'alt="Chart: Which suffice? Plotted: share 0.5 to 0.5."' in text
    assert f"palp study run paper --out {ran}/paper" in text  # not run here
    assert f"palp study run why --out {ran}/why" not in text
    assert flaws(text, alone=False) == []


def test_an_index_is_made_again_but_no_other_page_is_replaced(ran: Path) -> None:
    assert write_index(ran).read_bytes() == write_index(ran).read_bytes()
    (ran / "index.html").write_text("<html>mine</html>", encoding="utf-8")
    with pytest.raises(PalpError, match="page of something else"):
        write_index(ran)


def test_what_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(PalpError, match=r"no folder with a study; `palp study run NAME --out"):
        write_index(tmp_path)
    out = tmp_path / "one"
    out.mkdir()
    note = StudyNote(name="why", date="2026-01-01", command="palp study run why --out one", version="1")
    write_note(out, note)
    with pytest.raises(PalpError, match=r"index.html is missing .* palp study run why --out one"):
        write_index(tmp_path)
    (out / "study.json").write_text('{"name": "why"}', encoding="utf-8")
    with pytest.raises(PalpError, match="no note of a study"):
        write_index(tmp_path)


def test_every_study_names_a_chart_that_it_draws() -> None:
    room = Path(catalogue.__file__).parent
    sources = "".join(path.read_text("utf-8") for path in room.rglob("*.py") if path.name != "catalogue.py")
    drawn = {one.name: one.picture for one in STUDIES.values() if one.picture}
    assert set(drawn) == set(STUDIES)
    for name, stem in drawn.items():
        kinds = {stem, stem.rpartition("_")[0] + "_{"}  # as in f"mismatch_{world}"
        assert any(f'"{one}' in sources for one in kinds), name
