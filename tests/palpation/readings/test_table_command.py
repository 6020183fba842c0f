"""``palp analyse table.csv``: anybody's table, and what is wrong with it in words."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.errors import PalpError
from tests.support.made_up_readings import made_up

NAMED = ("--class", "material", "--setting", "action", "--trial", "trial", "--reading", "force,pitch")


def run(*arguments: object) -> Any:
    return CliRunner().invoke(app, ["analyse", *map(str, arguments)], catch_exceptions=False)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_up(6, 2).write(tmp_path_factory.mktemp("table") / "table.csv")


def test_a_table_gives_a_row_a_combination_and_every_file(table: Path, tmp_path: Path) -> None:
    out = tmp_path / "again"
    found = json.loads(run(table, *NAMED, "--policy", "all", "--folds", 3, "--out", out, "--json").stdout)
    assert [line["policy"] for line in found["results"]] == [
        *("recorded", "fixed: press", "fixed: slide", "uniform", "information_gain"),
    ]
    assert found["classes"] == ["felt", "silk", "wool"]
    assert json.loads((out / "analysis.json").read_text()) == found
    pictures = ("accuracy", "reliability", "progress", "confusion")
    assert {path.name for path in out.iterdir()} == {
        *("analysis.json", "analysis.csv", "trials.csv", "index.html"),
        *(f"{name}.{kind}" for name in pictures for kind in ("png", "svg", "csv")),
    }
    page = (out / "index.html").read_text(encoding="utf-8")
    assert "covariance of a cell: diagonal" in page
    assert "likelihood student_t: a cell is learnt from 8 readings" in page
    with (out / "trials.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 5 * 18
    assert (
        sum(row["policy"] == "recorded" and row["right"] == "1" for row in rows)
        == (found["results"][0]["accuracy"]["right"])
    )
    assert {row["settings"] for row in rows if row["policy"] == "fixed: press"} <= {"press", "press press"}


def test_it_says_on_the_screen_what_it_rests_on(table: Path) -> None:
    said = run(table, *NAMED, "--likelihood", "normal,student_t", "--folds", 3).stdout
    assert "72 readings of 3 classes at 2 settings in 18 trials" in said
    assert said.count("posterior_threshold") == 2
    assert "Wilson" in said


def test_a_table_needs_no_setting_and_no_trial(tmp_path: Path) -> None:
    path = tmp_path / "one.tsv"
    rows = [f"{name}\t{at + step}" for name, at in (("x", 0.0), ("y", 3.0)) for step in (0.0, 0.4, 1.1, 1.7)]
    path.write_text("what\tread\n" + "\n".join(rows) + "\n", encoding="utf-8")
    found = json.loads(run(path, "--class", "what", "--reading", "read", "--json").stdout)
    assert found["trials"] == 8
    assert found["results"][0]["readings_a_trial"] == 1.0


def test_readings_without_trials_are_dealt_into_some(table: Path) -> None:
    """Twelve a cell, two a setting: six trials a material."""
    named = [one for one in NAMED if one not in ("--trial", "trial")]
    found = json.loads(run(table, *named, "--deal", 2, "--policy", "all", "--json").stdout)
    assert found["trials"] == 18
    assert "18 trials were made up" in found["notes"][0]
    assert {line["policy"]: line["trials"] for line in found["results"]}["information_gain"] == 18
    with pytest.raises(PalpError, match="makes trials where there are none"):
        run(table, *NAMED, "--deal", 2)


def test_a_column_s_name_may_have_a_comma(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    rows = [f"{name},{at + step},0" for name, at in (("x", 0.0), ("y", 3.0)) for step in (0.0, 0.4, 1.1)]
    path.write_text('what,"peak, N",other\n' + "\n".join(rows) + "\n", encoding="utf-8")
    found = json.loads(run(path, "--class", "what", "--reading", '"peak, N"', "--json").stdout)
    assert found["columns"] == ["peak, N"]
    with pytest.raises(
        PalpError, match=r'reading \'peak\', reading \'N\'; there are: what, "peak, N", other'
    ):
        run(path, "--class", "what", "--reading", "peak, N")


def test_semicolons_a_byte_order_mark_and_empty_cells_are_read(tmp_path: Path) -> None:
    path = tmp_path / "sheet.csv"
    rows = [f"{name};{at + step}" for name, at in (("x", 0), ("y", 30)) for step in (0, 4, 11, 17)]
    path.write_text(
        "\ufeffwhat;read\n" + "\n".join([*rows, "y;", "x;NaN", "", "y;n/a"]) + "\n", encoding="utf-8"
    )
    found = json.loads(run(path, "--class", "what", "--reading", "read", "--json").stdout)
    assert found["notes"] == ["3 of 11 readings are left out: no finite number in read (rows 10, 11, 13)"]


def test_a_column_that_does_not_exist_is_answered_by_those_that_do(table: Path) -> None:
    with pytest.raises(
        PalpError, match="no column for class 'matter', reading 'forse'; there are: trial, mat"
    ):
        run(table, "--class", "matter", "--reading", "forse,pitch")
    with pytest.raises(
        PalpError, match=r"say with --class what was felt.*trial, material, action, force, pitch"
    ):
        run(table)
    with pytest.raises(PalpError, match="force is named for two things"):
        run(table, "--class", "force", "--reading", "force")


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "is empty"),
        ("a,b\n", "names of columns only"),
        ("a,b\nx,1\ny\n", "line 3 has 1 cell, the first line names 2"),
        ("a,b\nx,1\ny,one\n", "line 3: 'one' in column b is no number"),
        ("a,b\nx,1\n,2\n", "line 3 has no a"),
        ("a,b,b\nx,1,2\n", "two columns have the name b"),
        ("a,b\nx,1\ny,2\n", "has 1 reading, of which 0 are left"),
        ("a,b\nx,1\nx,2\n", r"table\.csv: all readings are of the class 'x'"),
        ("a,b\nx,1\ny,1\nx,1\ny,1\nx,1\ny,1\n", "all readings of b are 1; it tells nothing"),
    ],
)
def test_what_is_wrong_with_a_table_is_said(text: str, match: str, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(PalpError, match=match):
        run(path, "--class", "a", "--reading", "b")


def test_files_that_are_no_text_or_not_there_are_said(tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_bytes(b"a,b\n\xff\xfe")
    with pytest.raises(PalpError, match="no text in UTF-8"):
        run(tmp_path / "table.csv", "--class", "a", "--reading", "b")
    with pytest.raises(PalpError, match=r"other\.csv: cannot be read: No such file"):
        run(tmp_path / "other.csv", "--class", "a", "--reading", "b")


def test_options_of_the_other_kind_are_refused_rather_than_ignored(table: Path, tmp_path: Path) -> None:
    with pytest.raises(PalpError, match="--smoother, --depths: of sessions"):
        run(table, *NAMED, "--smoother", "none", "--depths", 31)
    with pytest.raises(PalpError, match="--class: of a table"):
        run(tmp_path, "--class", "material")
    with pytest.raises(PalpError, match="a table is analysed by itself"):
        run(table, tmp_path, *NAMED)
