import re
from pathlib import Path
from typing import Any

import jinja2
import pytest

import palp_core.palpation
from palp_core.palpation.reporting.charts import Chart
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.reporting.table import write_csv, write_records

ROOM = Path(palp_core.palpation.__file__).parent
CASE: dict[str, Any] = {
    "cells": ("<b>bold</b>", "a & b"), "why": "one", "survived": True, "name": "c",
    "fails_somewhere": True, "fails_at_the_rig": False,
}  # fmt: skip


@pytest.fixture
def given(tmp_path: Path) -> dict[str, Any]:
    """What a page of one table and one chart names, but for its rows."""
    chart = Chart("one", "Title", "Caption.", 1.0, ("x",), [(1,)], lambda figure: None)
    return {"head": ["one", "two"], "pictures": [picture(chart, tmp_path / "charts")]}


def test_a_page_needs_no_other_file_and_shows_markup_as_text(tmp_path: Path, given: dict[str, Any]) -> None:
    page = write_page(tmp_path / "new" / "index.html", "studies/stability.html", **given, rows=[CASE])
    text = page.read_text(encoding="utf-8")
    assert "&lt;b&gt;bold&lt;/b&gt;" in text
    assert "a &amp; b" in text
    assert "<b>" not in text
    assert "border-collapse" in text
    assert not re.search(r'(src|href)="(?!data:|#)', text)
    assert [path.name for path in page.parent.iterdir()] == ["index.html"]


def test_a_value_that_nobody_hands_in_is_an_error_and_leaves_no_page(
    tmp_path: Path, given: dict[str, Any]
) -> None:
    with pytest.raises(jinja2.UndefinedError, match="rows"):
        write_page(tmp_path / "index.html", "studies/stability.html", **given)
    less = {name: value for name, value in CASE.items() if name != "why"}
    with pytest.raises(jinja2.UndefinedError, match="why"):
        write_page(tmp_path / "index.html", "studies/stability.html", **given, rows=[less])
    assert not (tmp_path / "index.html").exists()


def test_a_picture_leaves_files_where_it_is_asked_for_them_and_names_them(tmp_path: Path) -> None:
    chart = Chart("one", "Title", "Caption.", 1.0, ("x",), [(1,)], lambda figure: None)
    alone = picture(chart)
    assert alone.files == ()
    shown = picture(chart, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == set(shown.files) == {"one.png", "one.svg", "one.csv"}
    assert (tmp_path / "one.svg").read_bytes() == shown.svg == alone.svg


def test_tags_and_styles_are_in_templates_alone() -> None:
    found = [
        str(path.relative_to(ROOM))
        for path in ROOM.rglob("*.py")
        if re.search(r"</?(p|h[1-6]|table|tr|td|th|figure|html|style|div)\b[^>]*>", path.read_text("utf-8"))
    ]
    assert found == []


def test_templates_stand_on_one_base_with_one_style_sheet() -> None:
    templates = ROOM / "reporting" / "templates"
    pages = [path for path in templates.rglob("*.html") if path.name not in ("base.html", "macros.html")]
    assert len(pages) > 10
    assert all(path.read_text("utf-8").startswith('{% extends "base.html" %}') for path in pages)
    styled = [path.name for path in templates.rglob("*.html") if "<style" in path.read_text("utf-8")]
    assert styled == ["base.html"]


def test_a_table_has_its_heading_and_an_empty_cell_for_nothing(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv", ("name", "x, mm"), [("a, b", 1.5), ("c", None)])
    assert (tmp_path / "a.csv").read_bytes() == b'name,"x, mm"\n"a, b",1.5\nc,\n'
    write_records(tmp_path / "b.csv", [{"x": 1, "y": None}, {"x": float("nan"), "y": "z"}])
    assert (tmp_path / "b.csv").read_bytes() == b"x,y\n1,\nnan,z\n"
