"""``palp methods measure`` as a user calls it: a page of every method, whatever ends it."""

from __future__ import annotations

import csv
import importlib
import math
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.cli.rig.measure import duration_s
from palp_core.errors import MethodError
from palp_core.methods import measured, register
from palp_core.methods.measured import measured_tasks
from palp_core.methods.register import GROUP, task, tasks
from palp_core.palpation.mechanics import Scene
from palp_core.palpation.session.method_choices import choose_for
from palp_core.palpation.studies.tradeoff import survey
from palp_core.palpation.studies.tradeoff.judge import panels
from tests.support.drawing import render_nothing

HERE = Path(__file__).parent
PATIENCE_S = 240.0
POINTS = (
    EntryPoint("toy", "toy_task:measure", measured.GROUP),
    EntryPoint("toy", "toy_task", GROUP),
)
AS_A_USER = f"""
import sys
from importlib.metadata import EntryPoint
sys.path.insert(0, {str(HERE)!r})
from palp_core.methods import measured, register
points = [EntryPoint(*one) for one in {[(one.name, one.value, one.group) for one in POINTS]!r}]
measured.entry_points = register.entry_points = lambda group: [one for one in points if one.group == group]
from palp_core.cli.main import main
main()
"""


RENDERED = ("survivor", "given0-")
"""What the names of tests end in or hold whose charts are rendered: a whole page, and words with markup."""


@pytest.fixture
def toys(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Iterator[None]:
    """A register of toys alone; what declares others is imported before, once and for all."""
    if not any(name in request.node.name for name in RENDERED):
        render_nothing(monkeypatch)
    tasks()
    monkeypatch.syspath_prepend(HERE)

    def found(group: str) -> list[EntryPoint]:
        return [one for one in POINTS if one.group == group]

    monkeypatch.setattr(register, "_REGISTER", {})
    monkeypatch.setattr(register, "_TASKS", {})
    for module in (measured, register):
        monkeypatch.setattr(module, "entry_points", found)
    register._points.cache_clear()
    monkeypatch.delitem(sys.modules, "toy_task", raising=False)
    importlib.import_module("toy_task")
    yield
    register._points.cache_clear()


def rows(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8") as opened:
        return list(csv.DictReader(opened))


@pytest.mark.usefixtures("toys")
def test_the_page_has_front_choice_failure_and_survivor(
    tmp_path: Path, strict_json: Callable[[Path], Any]
) -> None:
    done = CliRunner().invoke(app, ["methods", "measure", "--out", str(tmp_path), "--budget", "5min"])
    assert done.exit_code == 0, done.output
    head, columns, *printed, page = filter(None, done.stdout.splitlines())
    assert page == str(tmp_path / "index.html")
    assert head.startswith("toy: error of ")
    assert columns.split() == ["method", "setting", "cost", "error", "bound", "mark"]
    assert {line.split()[0] for line in printed} == {
        row["method"] for row in rows(tmp_path / "tradeoff_toy.csv")
    }
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {
        "index.html",
        "tradeoff.json",
        "tradeoff_toy.png",
        "tradeoff_toy.svg",
        "tradeoff_toy.csv",
    }
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    for words in ("quick: the cheapest within 10.0%", "gave no answer", "toy_task.py", "the truth"):
        assert words in page
    kept = strict_json(tmp_path / "tradeoff.json")
    (toy,) = kept["tasks"]
    assert (kept["ended"], toy["chosen"], toy["missing"]) == ("complete", "quick", "")
    assert kept["machine"]["unit_s"] > 0.0
    assert set(kept["versions"]) == {"palp", "python", "numpy", "scipy"}
    assert {len(one["digest"]) for one in toy["methods"]} == {16}
    by_setting = {(one["method"], one["setting"]): one for one in toy["points"]}
    assert by_setting["quick", ""]["error"] == 0.04  # the later one, against a finer reference
    assert [key for key, one in by_setting.items() if one["on_front"]] == [("quick", ""), ("slow", "")]
    assert [key for key, one in by_setting.items() if one["chosen"]] == [("quick", "")]
    assert by_setting["wrong", ""]["error"] is None
    assert (by_setting["wrong", ""]["why_not"], by_setting["wrong", ""]["survivor"]) == (
        "gave no answer",
        "quick",
    )
    table = {(row["method"], row["setting"]): row for row in rows(tmp_path / "tradeoff_toy.csv")}
    assert table["quick", "coarse"]["cost_s"] == "0.3"
    assert table.keys() == by_setting.keys()


@pytest.mark.usefixtures("toys")
def test_what_is_always_measured_under_a_condition_is_compared_under_each() -> None:
    toy = importlib.import_module("toy_task")
    choice = choose_for(task("toy"), Scene())
    light, heavy = ({"condition": words} for words in ("light", "heavy"))
    points = [
        toy.point("quick", 0.2, 0.04, **light),
        toy.point("slow", 2.0, 0.5, **light),
        toy.point("quick", 0.3, 0.9, **heavy),
        toy.point("slow", 2.0, 0.1, **heavy),
    ]
    found = panels(choice, points)
    assert [one.title for one in found] == ["answer, light", "answer, heavy"]
    assert [[one.point.method for one in panel.found if one.on_front] for panel in found] == [
        ["quick"],
        ["quick", "slow"],
    ]
    assert all([one.chosen for one in panel.found] == [True, False] for panel in found)
    (together,) = panels(choice, [*points, toy.point("slow", 1.0, 0.2)])
    assert [one.at_home for one in together.found] == [False] * 4 + [True]
    assert [one.on_front for one in together.found] == [False] * 4 + [True]


@pytest.mark.usefixtures("toys")
def test_a_measure_that_fails_leaves_the_page_what_there_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TOY_TASK", "breaks")
    done = CliRunner().invoke(app, ["methods", "measure", "--out", str(tmp_path)])
    assert done.exit_code == 1
    assert "toy: its measure failed: ZeroDivisionError: by nothing" in done.stderr
    assert {row["method"] for row in rows(tmp_path / "tradeoff_toy.csv")} == {"wrong", "quick"}


@pytest.mark.usefixtures("toys")
@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("wrong", math.nan, 0.1), "it gave 'wrong' a cost of nan s"),
        (("wrong", math.inf, 0.1), "it gave 'wrong' a cost of inf s"),
        (("wrong", -1.0, 0.1), "it gave 'wrong' a cost of -1 s"),
        (("wrong", 0.0, 0.1), "it gave 'wrong' a cost of 0 s"),
        (("unheard", 1.0, 0.1), "it measured 'unheard', of which task 'toy' has no method"),
    ],
)
def test_a_point_that_is_none_is_said_and_the_others_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: tuple[str, float, float], words: str
) -> None:
    toy = importlib.import_module("toy_task")

    def measure(_: Scene) -> Iterator[measured.Measured]:
        yield toy.point("quick", 0.1, 0.04, condition="a price of $3 or $5 _{")
        yield toy.point(*given)

    monkeypatch.setattr(toy, "measure", measure)
    done = CliRunner().invoke(app, ["methods", "measure", "--out", str(tmp_path)], catch_exceptions=False)
    assert (done.exit_code, f"toy: its measure failed: {words}" in done.stderr) == (1, True)
    assert {row["method"] for row in rows(tmp_path / "tradeoff_toy.csv")} == {"quick"}


@pytest.mark.usefixtures("toys")
def test_each_task_gets_its_first_point_before_any_has_its_second_and_the_cheapest_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    toy, asked = importlib.import_module("toy_task"), list[str]()

    def measure(name: str, begins_s: float) -> measured.Measure:
        @measured.begins_after(begins_s)
        def points(_: Scene) -> Iterator[measured.Measured]:
            for _count in range(2):
                asked.append(name)
                yield replace(toy.point("quick", 0.1, 0.04), task=name)

        return points

    names = {"dear": 9.0, "cheap": 0.1, "middle": 1.0}
    measures = {name: [measure(name, begins_s)] for name, begins_s in names.items()}
    monkeypatch.setattr(survey, "measure_of", measures.__getitem__)
    choice = choose_for(task("toy"), Scene())
    choices = [replace(choice, task=replace(choice.task, name=name)) for name in names]
    taken = survey.take(Scene(), choices)
    assert asked[:3] == ["cheap", "middle", "dear"]
    assert sorted(asked[3:]) == sorted(names)
    assert taken.left_out == ""


def test_every_measure_of_palp_says_when_it_begins() -> None:
    """Unsaid is first; so one that is dear would keep the cheap ones waiting."""
    for name in measured_tasks():
        assert measured.first_s(measured.measure_of(name)[0]) > 0.0, name


LOST = "what measures task 'toy', toy_task:nothing, cannot be loaded: AttributeError"


@pytest.mark.usefixtures("toys")
def test_a_task_asked_for_that_nothing_loaded_measures_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lost = EntryPoint("toy", "toy_task:nothing", measured.GROUP)
    monkeypatch.setattr(measured, "entry_points", lambda group: [lost] if group == measured.GROUP else [])
    done = CliRunner().invoke(app, ["methods", "measure", "--task", "toy", "--out", str(tmp_path / "out")])
    assert LOST in str(done.exception)
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("toys")
def test_a_measure_that_cannot_be_loaded_leaves_the_others_theirs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = [EntryPoint("toy", f"toy_task:{name}", measured.GROUP) for name in ("nothing", "measure")]
    monkeypatch.setattr(measured, "entry_points", lambda group: points if group == measured.GROUP else [])
    done = CliRunner().invoke(app, ["methods", "measure", "--out", str(tmp_path)])
    assert done.exit_code == 1
    assert f"left out: {LOST}" in done.output
    assert (tmp_path / "tradeoff_toy.png").exists()


@pytest.mark.usefixtures("toys")
def test_no_chart_of_an_earlier_survey_stays_beside_a_page_that_has_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    toy = importlib.import_module("toy_task")
    assert CliRunner().invoke(app, ["methods", "measure", "--out", str(tmp_path)]).exit_code == 0
    assert (tmp_path / "tradeoff_toy.png").exists()
    monkeypatch.setattr(toy, "measure", lambda _: iter(()))
    assert CliRunner().invoke(app, ["methods", "measure", "--out", str(tmp_path)]).exit_code == 0
    assert {path.name for path in tmp_path.iterdir()} == {"index.html", "tradeoff.json"}


@pytest.mark.usefixtures("toys")
def test_where_nothing_can_be_written_is_said_before_anything_is_measured(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for out, words in (
        (tmp_path / "file", "is a file, not a folder"),
        (Path("/proc/self"), "cannot be written"),
    ):
        done = CliRunner().invoke(app, ["methods", "measure", "--out", str(out)])
        assert words in str(done.exception)
        assert "--out" in str(done.exception)


@pytest.mark.usefixtures("toys")
def test_a_budget_beyond_any_clock_is_one_without_end(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["methods", "measure", "--out", str(tmp_path), "--budget", "99999999999h"])
    assert done.exit_code == 0, done.output


@pytest.mark.usefixtures("toys")
def test_what_never_ends_is_left_at_the_end_of_the_budget(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TOY_TASK", "waits")
    done = CliRunner().invoke(app, ["methods", "measure", "--out", str(tmp_path), "--budget", "0.5s"])
    assert done.exit_code == 0, done.output
    assert done.stderr == (
        "time was up, and the page has what there was; left out: toy: not measured to its end\n"
    )
    assert "Time was up." in (tmp_path / "index.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_ctrl_c_writes_the_page_and_ends_with_130(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", AS_A_USER, "methods", "measure", "--out", str(tmp_path), "--budget", "1h"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"TOY_TASK": "waits"},
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "measured\n"
        process.send_signal(signal.SIGINT)
        said, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, errors
    assert said.splitlines() == [str(tmp_path / "index.html")]
    assert errors.splitlines()[-1] == (
        "interrupted, and the page has what there was; left out: toy: not measured to its end"
    )
    assert {row["method"] for row in rows(tmp_path / "tradeoff_toy.csv")} == {"wrong", "quick"}
    assert "It was interrupted." in (tmp_path / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--task", "magic"], "nothing measures the methods of task 'magic'; measured are "),
        (["no_such.yaml"], "cannot read the scene"),
    ],
)
def test_what_is_not_there_is_named_before_anything_is_written(
    words: list[str], message: str, tmp_path: Path
) -> None:
    done = CliRunner().invoke(app, ["methods", "measure", *words, "--out", str(tmp_path / "out")])
    assert message in str(done.exception)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["60", "0s", "a while", "-3s", "3 days"])
def test_a_budget_that_is_no_duration_is_a_usage_error(text: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["methods", "measure", "--out", str(tmp_path / "out"), f"--budget={text}"])
    assert done.exit_code == 2
    assert not (tmp_path / "out").exists()


def test_durations_have_units() -> None:
    assert (duration_s("90s"), duration_s("1.5 min"), duration_s("2h")) == (90.0, 90.0, 7200.0)


def test_whatever_is_measured_is_a_task_with_methods() -> None:
    known = {one.name for one in tasks()}
    assert set(measured_tasks()) <= known
    with pytest.raises(MethodError, match="nothing measures"):
        measured.measure_of("no such task")
