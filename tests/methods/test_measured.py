"""``palp methods measure`` as a user calls it: tables of every method, whatever ends it."""

from __future__ import annotations

import importlib
import json
import math
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.cli.rig.methods import duration_s
from palp_core.methods import measured, register
from palp_core.methods.measured import measured_tasks
from palp_core.methods.register import GROUP, tasks
from palp_core.palpation.mechanics import Scene

HERE = Path(__file__).parent
POINTS = (
    EntryPoint("toy", "toy_task:measure", measured.GROUP),
    EntryPoint("toy", "toy_task", GROUP),
)


@pytest.fixture
def toys(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A register of toys alone; what declares others is imported before, once and for all."""
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
    yield importlib.import_module("toy_task")
    register._points.cache_clear()


def run(*words: str) -> Any:
    return CliRunner().invoke(app, ["methods", "measure", *words])


@pytest.mark.usefixtures("toys")
def test_the_table_has_every_method_its_bound_and_what_is_chosen() -> None:
    done = run()
    assert done.exit_code == 0, done.output
    head, columns, *rows = filter(None, done.stdout.splitlines())
    assert head.startswith("toy: error of answer against CPU time of a toy")
    assert columns.split() == ["method", "setting", "cost", "error", "bound", "mark"]
    wrong, quick, coarse, slow, finest = rows
    assert "gave no answer" in wrong
    assert quick.split() == ["quick", "200", "ms", "4.0%", "5.0%", "chosen"]  # the later, finer held
    assert coarse.split()[1] == "coarse"
    assert slow.split()[0] == "slow"
    assert "finest, the reference" in finest


@pytest.mark.usefixtures("toys")
def test_machines_get_every_point_and_no_number_that_is_none() -> None:
    points = json.loads(run("--json").stdout)
    assert [(one["method"], one["setting"]) for one in points] == [
        ("wrong", ""),
        ("quick", ""),
        ("quick", "coarse"),
        ("slow", ""),
        ("slow", "finest"),
    ]
    assert points[0]["error"] is None
    assert all(one["slowness"] > 0.0 for one in points)


@pytest.mark.usefixtures("toys")
@pytest.mark.parametrize(
    ("how", "status", "why"),
    [("breaks", 1, "left out: toy: its measure: ZeroDivisionError: by nothing"), ("is interrupted", 130, "")],
)
def test_a_measure_that_fails_or_ctrl_c_leaves_what_there_was(
    monkeypatch: pytest.MonkeyPatch, how: str, status: int, why: str
) -> None:
    monkeypatch.setenv("TOY_TASK", how)
    done = run()
    assert done.exit_code == status
    assert why in done.stderr
    assert "4.0%" in done.stdout
    assert "not measured" in done.stdout  # slow


@pytest.mark.parametrize(
    ("given", "words"),
    [
        *(
            (("wrong", cost, 0.1), f"it gave 'wrong' a cost of {cost:g} s")
            for cost in (math.nan, math.inf, -1.0, 0.0)
        ),
        (("unheard", 1.0, 0.1), "it measured 'unheard' of task 'toy', which is not in the register"),
    ],
)
def test_a_point_that_is_none_is_named_and_the_others_stay(
    toys: Any, monkeypatch: pytest.MonkeyPatch, given: tuple[str, float, float], words: str
) -> None:
    def measure(_: Scene) -> Iterator[measured.Measured]:
        yield toys.point("quick", 0.1, 0.04)
        yield toys.point(*given)

    monkeypatch.setattr(toys, "measure", measure)
    done = run()
    assert (done.exit_code, f"left out: toy: {words}" in done.stderr) == (1, True)
    assert "4.0%" in done.stdout


def test_each_task_gets_a_point_before_any_has_its_next(toys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[str]()

    def measure(name: str) -> Any:
        def points(_: Scene) -> Iterator[measured.Measured]:
            for setting in ("one", "two"):
                asked.append(name)
                yield measured.Measured(name, "quick", setting, 1.0, 0.1, "answer", "the truth")

        return points

    measures = {name: ([measure(name)], list[str]()) for name in ("first", "second")}
    monkeypatch.setattr(measured, "measures_of", measures.__getitem__)
    monkeypatch.setattr(measured, "names", lambda _: ["quick"])
    survey = measured.Survey(list(measures), Scene())
    survey.measure(1e6)
    assert asked == ["first", "second"] * 2
    assert len(survey.points) == 4
    assert not survey.missing
    late = measured.Survey(list(measures), Scene())
    late.measure(0.0)
    assert late.missing == ["first: time was up", "second: time was up"]
    assert not late.failed


@pytest.mark.usefixtures("toys")
@pytest.mark.parametrize("more", [[], ["toy_task:measure"]])
def test_a_measure_that_cannot_be_loaded_leaves_the_others_theirs(
    monkeypatch: pytest.MonkeyPatch, more: list[str]
) -> None:
    points = [EntryPoint("toy", value, measured.GROUP) for value in ["toy_task:nothing", *more]]
    monkeypatch.setattr(measured, "entry_points", lambda group: points if group == measured.GROUP else [])
    done = run("--task", "toy")
    assert done.exit_code == 1
    lost = "what measures task 'toy', toy_task:nothing, cannot be loaded: AttributeError"
    assert lost in (done.output if more else str(done.exception))
    assert ("4.0%" in done.stdout) == bool(more)


def test_what_is_not_there_is_named_and_durations_have_units() -> None:
    assert "nothing measures the methods of task 'magic'" in str(run("--task", "magic").exception)
    assert "cannot read the scene" in str(run("no_such.yaml").exception)
    assert [run(f"--budget={text}").exit_code for text in ("60", "0s", "a while", "-3s", "3 days")] == [2] * 5
    assert (duration_s("90s"), duration_s("1.5 min"), duration_s("2h")) == (90.0, 90.0, 7200.0)
    assert set(measured_tasks()) <= {one.name for one in tasks()}
