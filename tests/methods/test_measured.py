"""``palp methods measure`` as a user calls it: tables of every method, whatever ends it."""

from __future__ import annotations

import importlib
import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
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
from palp_core.methods.register import GROUP, tasks
from palp_core.palpation.mechanics import Scene

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
def test_a_measure_that_fails_leaves_what_there_was(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOY_TASK", "breaks")
    done = run()
    assert done.exit_code == 1
    assert "left out: toy: its measure: ZeroDivisionError: by nothing" in done.stderr
    assert "4.0%" in done.stdout
    assert "not measured" in done.stdout  # slow


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("wrong", math.nan, 0.1), "it gave 'wrong' a cost of nan s"),
        (("wrong", math.inf, 0.1), "it gave 'wrong' a cost of inf s"),
        (("wrong", -1.0, 0.1), "it gave 'wrong' a cost of -1 s"),
        (("wrong", 0.0, 0.1), "it gave 'wrong' a cost of 0 s"),
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


@pytest.mark.nightly
def test_ctrl_c_prints_what_there_is_and_ends_with_130() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", AS_A_USER, "methods", "measure", "--budget", "1h"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"TOY_TASK": "waits"},
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "measured\n"
        process.send_signal(signal.SIGINT)
        printed, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, errors
    assert "4.0%" in printed
    assert "not measured" in printed


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--task", "magic"], "nothing measures the methods of task 'magic'; measured are "),
        (["no_such.yaml"], "cannot read the scene"),
    ],
)
def test_what_is_not_there_is_named(words: list[str], message: str) -> None:
    assert message in str(run(*words).exception)


@pytest.mark.parametrize("text", ["60", "0s", "a while", "-3s", "3 days"])
def test_a_budget_that_is_no_duration_is_a_usage_error(text: str) -> None:
    assert run(f"--budget={text}").exit_code == 2


def test_durations_have_units() -> None:
    assert (duration_s("90s"), duration_s("1.5 min"), duration_s("2h")) == (90.0, 90.0, 7200.0)


def test_whatever_is_measured_is_a_task_with_methods() -> None:
    known = {one.name for one in tasks()}
    assert set(measured_tasks()) <= known
    with pytest.raises(MethodError, match="nothing measures"):
        measured.measures_of("no such task")
