"""What the shell offers after TAB."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from palp_core.cli import completion
from palp_core.cli.main import app
from tests.support.palp import SIM, Palp
from tests.support.talkative import Talk, talk

__all__ = ["talk"]


class Typed:
    """What is on the line already."""

    def __init__(self, **params: Any) -> None:
        self.params = params


def offered(function: Any, incomplete: str, **params: Any) -> list[str]:
    context: Any = Typed(**params)
    found: list[str] = function(context, incomplete)
    return found


def test_names_are_completed_as_they_are_typed_with_a_slash_or_without() -> None:
    names = ["/estimator", "/experiment", "/stage"]
    assert completion._matching(names, "") == names
    assert completion._matching(names, "/es") == ["/estimator"]
    assert completion._matching(names, "es") == ["estimator"]


def test_arguments_of_the_launch_file_and_their_choices_are_offered() -> None:
    assert offered(completion.launch_arguments, "tri", file=SIM) == ["trials:="]
    human = SIM.with_name("human.yaml")
    assert offered(completion.launch_arguments, "clock:=s", file=human) == ["clock:=sim"]
    assert "seed:=" not in offered(completion.launch_arguments, "", file=SIM, arguments=["seed:=1"])
    assert offered(completion.launch_arguments, "x", file=Path("none.yaml")) == []


def completed(palp: Palp, *words: str) -> list[str]:
    """Return what bash is offered, as its script asks."""
    line = {"COMP_WORDS": " ".join(["palp", *words]), "COMP_CWORD": str(len(words))}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {"XDG_RUNTIME_DIR": str(palp.runtime_dir), **line}.items():
            patch.setenv(name, value)
        done = CliRunner().invoke(app, prog_name="palp", env={"_PALP_COMPLETE": "complete_bash"})
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("to",), ["topic", "top"]),
        (("topic", "e"), ["echo"]),
        (("topic", "echo", "/source/s"), ["/source/sample"]),
        (("node", "info", "/"), ["/source", "/scale"]),
        (("param", "get", "/source", "ra"), ["rate_hz", "rare_hz"]),
        (("service", "call", "/scale/"), ["/scale/weigh"]),
        (("interface", "show", "Se"), ["Seen"]),
        (("node", "list", "--graph", "t"), ["talk"]),
        (("lifecycle", "set", "/source", "de"), ["deactivate"]),
        (("logs", "/so"), ["/source"]),
        (("study", "run", "pap"), ["paper"]),
    ],
)
def test_the_shell_completes_verbs_and_what_runs(
    talk: Talk, words: tuple[str, ...], offered: list[str]
) -> None:
    assert sorted(completed(talk.palp, *words)) == sorted(offered)


def test_without_a_graph_there_is_nothing_to_complete_and_no_noise(palp: Palp) -> None:
    assert completed(palp, "topic", "echo", "/") == []
