"""Pages: contrast by WCAG AA in both modes, one width, legends off the data, words explained."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import palp_core.palpation
from palp_core.palpation.reporting import charts
from palp_core.palpation.reporting.charts import Chart, image, in_percent, legend, number, save
from palp_core.palpation.reporting.html_page import outlined, picture, words_of, write_page
from palp_core.palpation.reporting.table import write_csv, write_records
from tests.palpation.reporting.page_flaws import flaws

ROOM = Path(palp_core.palpation.__file__).parent
STYLE = (ROOM / "reporting" / "templates" / "style.css").read_text("utf-8")
TEXT, GRAPHICS = 4.5, 3.0  # least contrast of words, and of lines and marks
LINES = ("BLUE", "VERMILION", "GREEN", "PINK", "SKY", "AMBER")


def rgb(colour: str) -> np.ndarray:
    return np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])


def luminance(colour: np.ndarray) -> float:
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(one: np.ndarray, other: np.ndarray) -> float:
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def tokens(mode: str) -> dict[str, np.ndarray]:
    light, dark = STYLE.split("prefers-color-scheme: dark")
    return {
        name: rgb(value)
        for name, value in re.findall(r"--(\w+): (#\w{6})", light if mode == "light" else dark)
    }


def in_the_dark(colour: np.ndarray) -> np.ndarray:
    """Return what the style's filter makes of a colour; the matrix is that of the Filter Effects module."""
    found = re.search(r"figure img \{ filter: invert\((\.\d+)\) hue-rotate\(180deg\); \}", STYLE)
    assert found
    share = float(found[1])
    weights = np.array([0.213, 0.715, 0.072])
    turn = 2.0 * np.tile(weights, (3, 1)) - np.eye(3)  # hue-rotate at cos = -1, sin = 0
    return np.clip(turn @ (share * (1.0 - colour) + (1.0 - share) * colour), 0.0, 1.0)


@pytest.mark.parametrize("mode", ["light", "dark"])
def test_words_stand_out_from_what_they_stand_on(mode: str) -> None:
    assert contrast(rgb("#777777"), rgb("#ffffff")) == pytest.approx(4.48, abs=0.005)  # the known near miss
    colour = tokens(mode)
    on = {"page": "ink soft accent assumed", "lead": "ink accent", "bad": "ink assumed", "good": "ink"}
    for ground, words in on.items():
        for word in words.split():
            assert contrast(colour[word], colour[ground]) >= TEXT, (word, ground)
    assert contrast(colour["rule"], colour["page"]) >= GRAPHICS


def test_lines_and_words_of_charts_stand_out_light_and_dark() -> None:
    white, dark = rgb("#ffffff"), in_the_dark(rgb("#ffffff"))
    assert dark == pytest.approx(tokens("dark")["page"], abs=0.01)  # a chart lies on the page without an edge
    for name, least in {**dict.fromkeys(LINES, GRAPHICS), "INK": TEXT, "GREY": TEXT}.items():
        before = rgb(getattr(charts, name))
        after = in_the_dark(before)
        assert contrast(before, white) >= least, name
        assert contrast(after, dark) >= least, f"{name} in the dark"
        if name in LINES:  # colours stay themselves
            assert (np.argmax(after), np.argmin(after)) == (np.argmax(before), np.argmin(before)), name


def test_numbers_of_charts_stand_out_from_their_rim_light_and_dark() -> None:
    axes = Figure().subplots()
    number(axes, 0.0, 0.0, "-46")
    (text,) = axes.texts
    (rim,) = text.get_path_effects()
    words, around = text.get_color(), rim._gc["foreground"]  # type: ignore[attr-defined]
    ink, ground = rgb(str(words)), rgb(to_hex(around))
    assert contrast(ink, ground) >= TEXT
    assert contrast(in_the_dark(ink), in_the_dark(ground)) >= TEXT


def test_every_figure_of_a_page_is_as_wide_as_the_others(tmp_path: Path) -> None:
    from matplotlib.image import imread

    for name, height in (("low", 2.0), ("high", 5.0)):
        save(Chart(name, "", "", height, ("x",), [(1,)], lambda figure: None), tmp_path)
    widths = {imread(tmp_path / f"{name}.png").shape[1] for name in ("low", "high")}
    assert widths == {round(charts.WIDTH_IN * 144)}


def test_a_legend_covers_no_data() -> None:
    drawn: list[Figure] = []

    def draw(figure: Figure) -> None:
        drawn.append(figure)
        for axes in figure.subplots(1, 2):
            axes.plot([0, 1], [0, 1], label="a line with a long name")
        legend(figure.axes[0], "title")
        legend(figure, "below", handles=figure.axes[0].get_lines())

    image(Chart("one", "", "", 3.0, ("x",), [(1,)], draw), "png")
    (figure,) = drawn
    legends = [*figure.legends, *(one for axes in figure.axes if (one := axes.get_legend()) is not None)]
    assert len(legends) == 2
    for one in legends:
        assert not any(one.get_window_extent().overlaps(axes.bbox) for axes in figure.axes)


def test_shares_are_written_in_per_cent_and_a_chart_is_described_in_words() -> None:
    axes = Figure().subplots()
    axes.plot([0.0, 1.0])
    axes.set_yticks([0.0, 0.5, 1.0])
    in_percent(axes.yaxis)
    assert [tick.get_text() for tick in axes.get_yticklabels()] == ["0", "50", "100"]
    rows = [("a", 2.0), ("b", 8.0)]
    chart = Chart("one", "Depth", "", 1.0, ("policy", "depth_mm"), rows, lambda figure: None)
    assert chart.alt == "Chart: Depth. Plotted: policy; depth mm 2 to 8."


def test_a_page_explains_the_words_that_it_uses_and_no_others() -> None:
    text = '<p title="trace">The markov permuted chain at r_a = 4 mm; <code>L2</code>.</p>'
    assert [name for name, _ in words_of(text)] == [
        "L0 to L5, rungs",
        "markov permuted",
        "r_a, ring position",
    ]
    assert words_of("<p>a node called emg</p>") == []
    assert words_of("<p>nothing of it; LATENTLY here</p>")[0][0] == "latent filter"


def test_headings_get_ids_and_the_contents_lead_to_them() -> None:
    found = outlined("<p>lead</p><h2>Why &amp; how</h2><h3>Why</h3><h2>Why</h2><h2 id='x'>no</h2>")
    assert found.lead == "<p>lead</p>"
    assert re.findall(r'<h\d id="([^"]+)"', found.rest) == ["why-how", "why", "why-2"]
    assert found.sections == [("why-how", "Why &amp; how"), ("why-2", "Why")]
    assert outlined("<p>only</p>").lead == "<p>only</p>"


GOOD = (
    '<!doctype html><html lang="en"><head>'
    '<meta name="viewport" content="width=device-width, initial-scale=1">'
    '<title>One</title></head><body><h1>One</h1><h2 id="a">A</h2><a href="#a">A</a>'
    '<div class="scroll"><img alt="words" src="data:,"></div></body></html>'
)


@pytest.mark.parametrize(
    ("part", "instead", "shown"),
    [
        (' lang="en"', "", "has no language"),
        ('alt="words"', 'alt=""', "pictures without words"),
        ("h2", "h3", "skips a level"),
        (' id="a"', "", "without id"),
        ("</body>", '<p id="a"></p></body>', "an id twice"),
        ('href="#a"', 'href="#b"', "leads to no id"),
        ('src="data:,"', 'src="a.png"', "needs another file"),
        ("<h1>One</h1>", "", "has not one first heading"),
        (' class="scroll"', "", "wider than a phone"),
        ("width=device-width", "width=900", "does not fit a phone"),
        ("</body>", "<p>nan</p></body>", "a value that is none"),
        ("</body>", "<div><nav></nav></div></body>", "within something else"),
    ],
)
def test_a_flaw_of_a_page_is_found(part: str, instead: str, shown: str) -> None:
    assert flaws(GOOD) == []
    assert shown in " ".join(flaws(GOOD.replace(part, instead)))


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


def test_a_value_that_is_not_handed_in_is_an_error_and_leaves_no_page(
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


def test_a_table_has_its_heading_and_an_empty_cell_for_nothing(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv", ("name", "x, mm"), [("a, b", 1.5), ("c", None)])
    assert (tmp_path / "a.csv").read_bytes() == b'name,"x, mm"\n"a, b",1.5\nc,\n'
    write_records(tmp_path / "b.csv", [{"x": 1, "y": None}, {"x": float("nan"), "y": "z"}])
    assert (tmp_path / "b.csv").read_bytes() == b"x,y\n1,\nnan,z\n"
