"""The bench of choices sees a tolerance that is not kept, a bound that is broken, a refusal without need."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import choices as bench
from benchmarks.choice_bench import contest, table
from palp_core.methods import Bound, declare_quantity, declare_task, method, register

WORDS = {"near": 1.0}
declare_quantity("near", "1", "how near a scene is to those in which the methods were measured")


@pytest.fixture(name="made_up")
def _made_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Declare a task of three methods, each dearer and righter than the one before."""
    monkeypatch.setattr(register, "_REGISTER", {})
    monkeypatch.setattr(register, "_TASKS", {})
    declare_task("made_up", "?", per="use", output="angle", tolerance=0.1)
    for name, cost_s, error in (("rough", 1.0, 0.3), ("good", 3.0, 0.1), ("fine", 9.0, 0.01)):
        method(
            task="made_up", name=name, cost_s=cost_s, evidence="here",
            bounds=[Bound("angle", error, within={"near": (0.0, 1.0)})],
        )(lambda: None)  # fmt: skip


def judged(tolerance: float, errors: dict[str, tuple[float, float]], **scene: float) -> Any:
    """Return the verdict on a scene in which methods are as wrong as this, each with its spread."""

    def measure(name: str, number: int) -> Any:
        error, sd = errors[name]
        return contest.Reading(error, sd / 2**number)

    return contest.judge(contest.Case("made_up", "angle", tolerance, scene or WORDS, measure), 0)


@pytest.mark.usefixtures("made_up")
def test_a_choice_that_is_right_enough_is_held_against_the_cheapest_that_would_have_been() -> None:
    exact = {"rough": (0.2, 0.0), "good": (0.05, 0.0), "fine": (0.005, 0.0)}
    one = judged(0.15, exact)
    assert (one.chosen, one.kept, one.best, one.cost_ratio, one.broken) == ("good", "yes", "good", 1.0, [])
    one = judged(0.25, exact)
    assert (one.chosen, one.best, one.cost_ratio) == ("good", "rough", 3.0)


@pytest.mark.usefixtures("made_up")
def test_a_tolerance_that_is_not_kept_and_a_bound_that_is_broken_are_told() -> None:
    one = judged(0.15, {"rough": (0.2, 0.0), "good": (0.16, 0.0)})
    assert one.kept == "no"
    assert one.broken == ["good: 0.16, stated 0.1"]
    line = table.Line.of("made_up", [one], 0)
    assert (line.answered, line.kept, line.not_kept, line.bounds_broken) == (1, 0, 1, 1)
    assert (line.kept_high or 1.0) < 1.0


@pytest.mark.usefixtures("made_up")
def test_what_chance_leaves_open_is_measured_longer_and_else_told_as_unclear() -> None:
    assert judged(0.15, {"rough": (0.29, 0.0), "good": (0.05, 0.04)}).kept == "yes"
    one = judged(0.15, {"rough": (0.29, 0.0), "good": (0.149, 0.4)})
    assert (one.kept, one.broken) == ("unclear", [])
    assert judged(0.15, {"rough": (0.29, 0.0), "good": (0.3, 0.1)}).kept == "no"


@pytest.mark.usefixtures("made_up")
def test_a_refusal_is_needless_where_a_method_would_have_done() -> None:
    errors = {"rough": (0.2, 0.0), "good": (0.05, 0.0), "fine": (0.005, 0.0)}
    one = judged(0.1, errors, near=2.0)
    assert (one.chosen, one.needless, one.best) == ("", True, "good")
    assert not judged(0.001, errors).needless


def test_every_task_of_the_register_is_drawn_but_that_of_the_study() -> None:
    declared = {entry.name for entry in entry_points(group="palp.methods")}
    assert set(bench.CONTESTS) == declared - {"contact"}


def test_a_few_scenes_keep_their_tolerance_and_are_the_same_again(tmp_path: Path) -> None:
    light = ["likelihood", "denoise"]
    told: list[str] = []
    outcome = bench.run(light, 3, 7, told.append)
    assert [one.kept for one in outcome.verdicts if one.kept != "yes" and one.chosen] == []
    assert not any(one.broken for one in outcome.verdicts)
    assert len(told) == 6
    again = bench.run(light[:1], 3, 7)
    assert again.verdicts == [one for one in outcome.verdicts if one.task == "likelihood"]
    table.write(tmp_path, outcome.lines(), outcome.verdicts, {"seed": 7})
    assert json.loads((tmp_path / "choices.json").read_text(encoding="utf-8"))["seed"] == 7
    assert {path.name for path in tmp_path.iterdir()} >= {"choices.json", "scenes.csv", "choices.png"}


@pytest.mark.nightly
def test_more_tasks_keep_their_tolerance_and_their_bounds() -> None:
    outcome = bench.run(["motion", "feature", "filter", "stop", "policy"], 6, 8)
    assert [one.words for one in outcome.verdicts if one.kept == "no" or one.broken] == []


def test_an_interrupt_keeps_what_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    draws: Callable[..., Any] = bench.CONTESTS["likelihood"]

    def stops(rng: np.random.Generator, index: int) -> Any:
        if index == 2:
            raise KeyboardInterrupt
        return draws(rng, index)

    monkeypatch.setitem(bench.CONTESTS, "likelihood", stops)
    outcome = bench.run(["likelihood"], 10, 7)
    assert (len(outcome.verdicts), outcome.ended) == (2, "interrupted")
