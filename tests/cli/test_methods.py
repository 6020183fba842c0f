"""``palp methods list``: every method, its mark in a scene, and the same for machines."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.methods import methods, tasks

PROMISED = {"task", "name", "cost_s", "error", "valid", "evidence", "fails", "survivor"}


def listed(*arguments: str) -> list[dict[str, Any]]:
    result = CliRunner().invoke(app, ["methods", "list", *arguments, "--json"])
    assert result.exit_code == 0, result.output
    found: list[dict[str, Any]] = json.loads(result.stdout)
    return found


def test_the_list_for_machines_has_every_method_of_every_task() -> None:
    found = listed()
    assert all(one.keys() >= PROMISED for one in found)
    listed_names = {(one["task"], one["name"]) for one in found}
    assert listed_names == {(task.name, one.name) for task in tasks() for one in methods(task.name)}


def test_one_method_of_a_task_at_most_is_chosen_and_it_is_the_cheapest_that_is_right_enough() -> None:
    found = listed("contact")
    assert [one["name"] for one in found if one["mark"] == "chosen"] == ["l2"]
    assert {one["name"] for one in found if one["mark"] == "not available here"} == {"l0"}
    assert [one["cost_s"] for one in found] == sorted(one["cost_s"] for one in found)
    assert all(one["slowness"] > 0.0 for one in found)


def test_a_scene_is_asked_by_its_own_output_and_tolerance(tmp_path: Path) -> None:
    file = tmp_path / "deep.yaml"
    file.write_text(
        "phantom: {bead: {depth_m: 0.008}}\ntolerance: {output: contrast, relative: 0.03}\n", encoding="utf-8"
    )
    (chosen,) = [one for one in listed("contact", "--scene", str(file)) if one["mark"] == "chosen"]
    assert (chosen["name"], chosen["output"]) == ("l4", "contrast")
    assert chosen["error"] <= 0.03


def test_a_person_reads_cost_and_error_of_each_method_and_below_its_mark() -> None:
    result = CliRunner().invoke(app, ["methods", "list", "contact"])
    lines = result.stdout.splitlines()
    assert lines[0].startswith("contact: With what force does the gel answer a ball in it?")
    places = {line.split()[0]: place for place, line in enumerate(lines) if line[:1] == "l"}
    assert sorted(places) == ["l0", "l2", "l4", "l5"]
    assert lines[places["l2"]].split()[-1] == "1.2%"
    assert lines[places["l2"] + 1] == "    chosen: the cheapest within 2.0%; launch/sim.yaml takes it"
    assert lines[places["l0"] + 1].startswith("    not available here: ")
    assert lines[places["l2"] - 1] == "    survivor: l2"
    assert "  l2: Hertz with the bonded layer's correction;" in result.output


SCENES = {"hard.yaml": "phantom: {poisson: 0.5}\n", "under.yaml": "ring_m: -0.004\n"}
UNDER = "ring_m: -0.004 m makes the joint unstable; keep the ring at or over the pivot"


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (["methods", "list", "contact", "--scene", "hard.yaml"], "None is accurate enough here"),
        (["methods", "list", "nothing"], "no task 'nothing'; there are"),
        (["methods", "list", "--scene", "no.yaml"], "no.yaml"),
        (["methods", "list", "--scene", "under.yaml"], UNDER),
        (["scene", "run", "under.yaml"], UNDER),
    ],
)
def test_what_has_no_method_is_reported(
    call: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in SCENES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    result = CliRunner().invoke(app, call)
    assert words in result.output + str(result.exception)


@pytest.mark.parametrize(
    ("width", "longest", "task"),
    [(30, 30, "contact"), (60, 60, "stop"), (100, 100, "policy"), (400, 100, "contact")],
)
def test_no_word_is_lost_and_no_line_is_long(
    width: int, longest: int, task: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    output = CliRunner().invoke(app, ["methods", "list", task]).stdout
    words = [word for line in output.splitlines() if len(line) > longest for word in line.split()]
    assert all(len(word) > longest - 6 for word in words), words
    texts = " ".join(f"{one.name} {one.fails} {one.survivor}" for one in methods(task))
    assert set(texts.split()) <= set(output.split())
