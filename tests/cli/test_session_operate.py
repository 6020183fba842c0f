"""The operator's desk: what is asked is shown, what is typed goes to who asked, and a name goes nowhere."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from typer.testing import CliRunner

from palp_core.cli.session import app
from palp_core.cli.session.operate import Desk, effort_line
from palp_core.graph.messages.frame import Frame, Kind, pack, parse
from palp_core.graph.messages.topic import Topic
from palp_core.palpation.session.human.questions import IDENTITY

PROMPT = Topic(name="/session/prompt", type="Prompt", node="session")
COUNT = Topic(name="/session/countdown", type="Countdown", node="session")


class Graph:
    """A running graph that takes what it is asked."""

    alive = True

    def __init__(self, *, taken: bool = True) -> None:
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.taken = taken

    def ask(self, node: str, operation: str, **fields: Any) -> dict[str, Any]:
        assert operation == "call"
        self.asked.append((node, fields["request"]))
        return {"reply": {"taken": self.taken, "text": "" if self.taken else "not this"}}


def frame(topic: Topic, **fields: Any) -> Frame:
    return parse(pack(topic.name.encode(), Kind.DATA, 0, 1, 0, 0, msgspec.msgpack.encode(fields)))


def prompt(number: int, kind: str, text: str = "What?", choices: tuple[str, ...] = ()) -> Frame:
    return frame(PROMPT, number=number, kind=kind, text=text, choices=choices, ends_ns=0)


@pytest.fixture
def graph() -> Graph:
    return Graph()


@pytest.fixture
def desk(graph: Graph) -> Desk:
    return Desk(graph, [PROMPT, COUNT], 1.0)  # type: ignore[arg-type]


def test_what_is_asked_is_shown_and_answered_by_its_number(
    desk: Desk, graph: Graph, capsys: pytest.CaptureFixture[str]
) -> None:
    desk.show(prompt(3, "choice", "How deep?", ("2", "4")))
    assert "How deep? [2 / 4]" in capsys.readouterr().out
    desk.answer("4")
    assert graph.asked == [("session", {"number": 3, "text": "4", "by": "terminal"})]
    graph.taken = False
    desk.answer("x")
    assert "not this" in capsys.readouterr().err
    desk.show(prompt(4, "none", "Thank you."))
    desk.answer("")
    assert len(graph.asked) == 2
    assert "nothing is asked" in capsys.readouterr().err


def test_a_name_does_not_leave_the_terminal(
    desk: Desk, graph: Graph, capsys: pytest.CaptureFixture[str]
) -> None:
    for kind in ("subject", "consent"):
        desk.show(prompt(1, "text", IDENTITY[kind]))
        desk.answer("Anna Mueller")
        assert graph.asked == []
        text = capsys.readouterr().err
        assert "code" in text
        assert "Anna" not in text
    desk.answer("C-17")
    assert len(graph.asked) == 1


def test_time_and_effort_are_shown(desk: Desk, capsys: pytest.CaptureFixture[str]) -> None:
    desk.show(frame(COUNT, what="palpation", left_s=41.0, of_s=60.0))
    assert "palpation: 41 s left" in capsys.readouterr().out
    assert effort_line({"fds": 0.5, "edc": 1.4, "clipped": True}).endswith("CLIPPED")


def test_the_plan_is_shown_without_a_rig() -> None:
    done = CliRunner().invoke(app, ["plan"])
    assert "training: 15 trials, A 5 times, B 5 times, C 5 times" in done.stdout
    assert "15 questions" in done.stdout
