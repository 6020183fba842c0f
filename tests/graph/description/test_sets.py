"""One word that sets several arguments: what it sets are defaults, and each can still be given."""

from __future__ import annotations

from typing import Any

import pytest

from palp_core.graph.description.launch_file import arguments_text
from palp_core.graph.description.resolver import resolve
from tests.graph.description.conftest import FILES

WHOLE, PART = FILES["an argument that sets others"].values()
GIVEN = "args: {source: torque}"


def set_to(workspace: Any, *overrides: str, whole: str = WHOLE, part: str = PART) -> tuple[Any, Any]:
    workspace.write("launch/parts/part.yaml", part)
    torque, estimator = workspace.load(whole, *overrides).nodes
    return torque.params["rate_hz"], estimator.params["gain"]


@pytest.mark.parametrize(
    ("overrides", "given", "values"),
    [
        ((), GIVEN, (500.0, 1.0)),
        (("speed:=fast",), GIVEN, (2000.0, 3.0)),
        (("speed:=fast", "gain:=7"), GIVEN, (2000.0, 7.0)),
        (("gain:=7", "speed:=fast"), GIVEN, (2000.0, 7.0)),
        ((), "args: {source: torque, speed: fast}", (2000.0, 3.0)),
        (("gain:=7",), "args: {source: torque, speed: fast}", (2000.0, 7.0)),
        (("speed:=fast",), "args: {source: torque, gain: 5.0}", (2000.0, 5.0)),
    ],
)
def test_a_word_sets_defaults_and_what_is_given_on_the_command_line_or_by_an_include_wins(
    workspace: Any, overrides: tuple[str, ...], given: str, values: tuple[float, float]
) -> None:
    assert set_to(workspace, *overrides, whole=WHOLE.replace(GIVEN, given)) == values


def test_what_the_including_file_declares_wins_over_what_a_word_sets(workspace: Any) -> None:
    declares = WHOLE.replace("clock: sim", "clock: sim\nargs: {gain: {default: 4.0}}")
    assert set_to(workspace, "speed:=fast", whole=declares) == (2000.0, 4.0)


def test_an_argument_of_any_value_sets_by_those_that_it_names(workspace: Any) -> None:
    anything = PART.replace("    choices: [usual, fast]\n", "")
    assert set_to(workspace, "speed:=fast", part=anything) == (2000.0, 3.0)
    assert set_to(workspace, "speed:=my.yaml", part=anything) == (500.0, 1.0)


def test_it_does_not_matter_which_is_declared_first(workspace: Any) -> None:
    speed, rest = PART.removeprefix("args:\n").split("  source:")
    moved = f"args:\n  source:{rest.replace('nodes:', f'{speed}nodes:', 1)}"
    assert set_to(workspace, "speed:=fast", part=moved) == (2000.0, 3.0)


def test_what_a_word_sets_is_shown(workspace: Any) -> None:
    path = workspace.write("launch/parts/part.yaml", PART)
    assert "(fast sets: rate_hz:=2000, gain:=3.0)" in arguments_text(resolve(path, ["source:=a"]))
