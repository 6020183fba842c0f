"""``palp methods measure`` as a user calls it: tables of every method, whatever ends it."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.methods import measured, register
from palp_core.methods.measured import cpu_s, measure_of, measured_tasks
from palp_core.palpation.mechanics import Scene


@pytest.fixture
def toys(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A register of toys alone."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    monkeypatch.delitem(sys.modules, "toy_task", raising=False)
    made = register.Register()
    made.quantities = register.quantities()
    made.read("toy_task")
    monkeypatch.setattr(register, "register", lambda: made)
    monkeypatch.setattr("palp_core.methods.choice.register", lambda: made)
    return sys.modules["toy_task"]


def run(*words: str) -> Any:
    return CliRunner().invoke(app, ["methods", "measure", *words])


@pytest.mark.usefixtures("toys")
def test_the_table_has_every_method_its_bound_and_what_is_chosen() -> None:
    done = run()
    assert done.exit_code == 0, done.output
    head, columns, *rows = filter(None, done.stdout.splitlines())
    assert head.startswith("toy: error of answer against CPU time of a toy")
    assert columns.split() == ["method", "setting", "cost", "stated", "error", "bound", "mark"]
    wrong, quick, coarse, slow, finest = rows
    assert "gave no answer" in wrong
    assert quick.split()[:3] + quick.split()[5:] == [
        "quick",
        "200",
        "ms",
        "4.0%",
        "5.0%",
        "chosen",
    ]  # the later, finer held
    assert coarse.split()[1] == "coarse"
    assert slow.split()[0] == "slow"
    assert "finest, the reference" in finest
    points = json.loads(run("--json").stdout)
    settings = [("wrong", ""), ("quick", ""), ("quick", "coarse"), ("slow", ""), ("slow", "finest")]
    assert [(one["method"], one["setting"]) for one in points] == settings
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
    ("point", "problem"),
    [
        *(
            (("wrong", cost, 0.1), f"it gave 'wrong' a cost of {cost:g} s")
            for cost in (math.nan, math.inf, -1.0, 0.0)
        ),
        (("unheard", 1.0, 0.1), "it measured 'unheard' of task 'toy', which is not in the register"),
    ],
)
def test_a_point_that_is_none_is_named_and_the_others_stay(
    toys: Any, monkeypatch: pytest.MonkeyPatch, point: tuple[str, float, float], problem: str
) -> None:
    monkeypatch.setattr(toys, "measure", lambda _: iter([toys.point("quick", 0.1, 0.04), toys.point(*point)]))
    done = run()
    assert (done.exit_code, f"left out: toy: {problem}" in done.stderr) == (1, True)
    assert "4.0%" in done.stdout


def test_each_task_gets_a_point_before_any_has_its_next(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[str]()

    def measure(name: str) -> Any:
        def points(_: Scene) -> Iterator[measured.Measured]:
            for setting in ("one", "two"):
                asked.append(name)
                yield measured.Measured(name, "quick", setting, 1.0, 0.1, "answer", "the truth")

        return points

    monkeypatch.setattr(measured, "measure_of", measure)
    monkeypatch.setattr(register, "names", lambda _: ["quick"])
    survey = measured.Survey(["first", "second"], Scene())
    survey.measure(1e6)
    assert asked == ["first", "second"] * 2
    assert len(survey.points) == 4
    assert not survey.missing
    late = measured.Survey(["first", "second"], Scene())
    late.measure(0.0)
    assert late.missing == ["first: time was up", "second: time was up"]
    assert not late.failed


def test_what_is_not_there_is_named() -> None:
    assert "no task 'magic'; there are " in str(run("--task", "magic").exception)
    assert "nothing measures the methods of task 'burst'" in str(run("--task", "burst").exception)
    assert "cannot read the scene" in str(run("no_such.yaml").exception)
    assert [run(f"--budget={text}").exit_code for text in ("0", "a while", "-3")] == [2] * 3
    assert [callable(measure_of(task)) for task in measured_tasks()] == [True] * 4


def test_a_first_call_that_loads_modules_is_not_what_a_call_costs(monkeypatch: pytest.MonkeyPatch) -> None:
    now_ns = [0]

    def action() -> None:
        now_ns[0] += 1_000_000 if "of_a_test" in sys.modules else 1_000_000_000
        monkeypatch.setitem(sys.modules, "of_a_test", sys)

    assert cpu_s(action, clock=lambda: now_ns[0]) == 1e-3
