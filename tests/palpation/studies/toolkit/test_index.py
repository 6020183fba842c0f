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


def run_of_stability(out: Path, *, quick: bool = False, workers: int = 1, dask: str = "") -> Path:
    """Write a page as the study ``stability`` does, without its work."""
    chart = Chart("stability", "All cases", "", 2.0, ("share",), [(0.5,)], lambda figure: None)
    return write_page(
        out / "index.html", "studies/stability.html", head=["one"], cases=[], chart=picture(chart, out)
    )


@pytest.fixture
def ran(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder in which the study ``stability`` was run by the command line."""
    monkeypatch.setattr(
        catalogue,
        "STUDIES",
        STUDIES
        | {
            "stability": Study(
                "stability",
                STUDIES["stability"].question,
                f"{__name__}:run_of_stability",
                picture="stability",
            )
        },
    )
    monkeypatch.setattr("palp_core.palpation.studies.catalogue.study", lambda name: catalogue.STUDIES[name])
    done = CliRunner().invoke(
        app, ["run", "stability", "--out", str(tmp_path / "my run"), "--quick", "--workers", "2"]
    )
    assert done.exit_code == 0, done.output
    return tmp_path


def test_a_run_leaves_a_note_that_runs_it_again(ran: Path) -> None:
    note = json.loads((ran / "my run" / "study.json").read_text("utf-8"))
    assert note["command"] == f"palp study run stability --out '{ran}/my run' --quick --workers 2"
    assert note["quick"] is True
    assert len(note["date"].split("-")) == 3


def test_the_index_has_picture_question_answer_date_and_command(ran: Path) -> None:
    done = CliRunner().invoke(app, ["index", str(ran)])
    assert done.output.strip() == str(ran / "index.html")
    text = (ran / "index.html").read_text("utf-8")
    note = json.loads((ran / "my run" / "study.json").read_text("utf-8"))
    assert STUDIES["stability"].question in text
    assert "0 methods that look reasonable: 0 fail somewhere in what was tried" in text
    assert "Run with --quick: no result." in text
    assert note["date"] in text
    assert note["command"].replace("'", "&#39;") in text
    assert 'src="my%20run/stability.png"' in text
    assert 'alt="Chart: All cases. Plotted: share 0.5 to 0.5."' in text
    assert f"palp study run paper --out {ran}/paper" in text  # not run here
    assert f"palp study run stability --out {ran}/stability" not in text
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
    note = StudyNote(
        name="stability", date="2026-01-01", command="palp study run stability --out one", version="1"
    )
    write_note(out, note)
    with pytest.raises(PalpError, match=r"index.html is missing .* palp study run stability --out one"):
        write_index(tmp_path)
    (out / "study.json").write_text('{"name": "stability"}', encoding="utf-8")
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
