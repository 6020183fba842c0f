"""The operator's desk on the page: what is asked, what is answered, and what may not leave it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from palp_core.graph.messages.topic import Topic
from palp_core.palpation.live_page.desk import DeskMonitor
from palp_core.palpation.live_page.page import human, rig
from palp_core.palpation.session.human.questions import IDENTITY, QUESTION
from palp_core.view.source.overview import NodeState, Overview

pytest.importorskip("nicegui")
pytest.importorskip("nicegui.testing.user_simulation")

from palp_core.view.pages.viewer import OwnPage, Viewer
from tests.support.view.fake_source import FakeOperator, FakeSource
from tests.support.view.simulated_user import simulated

KINDS = ("Prompt", "Countdown", "EffortBars", "HumanTrialDone")


class SessionSource(FakeSource):
    """A session with a person that has published this so far."""

    def __init__(self) -> None:
        topics = [Topic(name=f"/session/{k.lower()}", type=k, node="session", json_schema={}) for k in KINDS]
        nodes = [NodeState(name="session")]
        super().__init__(Overview(kind="graph", title="human", clock="wall", now_s=1.0, nodes=nodes), topics)

    def publish(self, kind: str, at_ns: int, /, **message: Any) -> None:
        self.add(kind, at_ns, {"stamp_ns": at_ns, **message})

    def ask(self, number: int, kind: str, text: str, *choices: str) -> None:
        self.publish("Prompt", number, number=number, kind=kind, text=text, choices=list(choices), ends_ns=0)

    def done(self, at_ns: int, number: int, attempt: int = 1, *, estimate_m: float = 0.0) -> None:
        self.publish(
            "HumanTrialDone", at_ns, trial=number, phase="estimation", number=number, attempt=attempt,
            phantom="B", palpation_s=12.3, ended_by="subject" if estimate_m else "repeat",
            answered=estimate_m > 0.0, answer_s=1.0, estimate_m=estimate_m,
        )  # fmt: skip


def answered_by(why_not: str = "") -> FakeOperator:
    return FakeOperator(taken=not why_not, text=why_not)


def put(viewer: Viewer, page: Callable[[Viewer], None] = human) -> Callable[[], None]:
    return lambda: OwnPage(page).fill(viewer)


def page_of(session: SessionSource, answered: FakeOperator | None) -> Viewer:
    return Viewer(source=session, operator=answered)  # type: ignore[arg-type]


async def called(answered: FakeOperator, count: int) -> None:
    while len(answered.calls) < count:
        await asyncio.sleep(0.01)


def test_what_is_asked_is_answered_by_a_press_to_the_node_and_prompt_that_asked() -> None:
    session, answered = SessionSource(), answered_by()
    session.ask(7, "enter", "Palpating.", "", "again")

    async def look(user: Any) -> None:
        await user.should_see("Palpating.")
        user.find("again").click()
        await called(answered, 1)
        session.ask(8, "choice", QUESTION, "2", "4", "8")
        await user.should_see(QUESTION)
        await user.should_not_see("again")
        user.find("4").click()
        await called(answered, 2)
        session.ask(9, "none", "The subject rests.")
        await user.should_see("The subject rests.")
        await user.should_not_see("go on (Enter)")

    simulated(put(page_of(session, answered)), look)
    assert answered.calls == [
        ("session", "answer", {"number": 7, "text": "again", "by": "page"}, False),
        ("session", "answer", {"number": 8, "text": "4", "by": "page"}, False),
    ]


def test_what_may_be_a_name_is_refused_before_it_is_sent_and_a_code_is() -> None:
    from nicegui import ui

    session, answered = SessionSource(), answered_by()
    session.ask(1, "text", IDENTITY["subject"])

    async def look(user: Any) -> None:
        await user.should_see(IDENTITY["subject"])
        user.find(ui.input).type("Jane Doe")
        user.find("send").click()
        await user.should_see("use a code as S01")
        assert answered.calls == []
        user.find(ui.input).clear().type("S01")
        user.find("send").click()
        await called(answered, 1)

    simulated(put(page_of(session, answered)), look)
    assert answered.calls[0][2]["text"] == "S01"


def test_an_answer_that_is_not_taken_is_reported_on_the_page_of_the_rig_too() -> None:
    session, answered = SessionSource(), answered_by("that is not asked any more")
    session.ask(2, "enter", "Mount phantom K7, indent 4.0 mm.")

    async def look(user: Any) -> None:
        await user.should_see("Mount phantom K7")
        user.find("go on (Enter)").click()
        await user.should_see("that is not asked any more")

    simulated(put(page_of(session, answered), rig), look)


def test_where_nothing_may_be_pressed_it_says_why_and_over_a_bag_nothing_can_be() -> None:
    session, answered = SessionSource(), answered_by()
    session.ask(3, "enter", "Enter begins it.")
    answered.refused = "start palp view with --operate"

    async def refused(user: Any) -> None:
        await user.should_see("start palp view with --operate")
        await user.should_not_see("go on (Enter)")

    async def over(user: Any) -> None:
        await user.should_see("what is shown is over")
        await user.should_not_see("go on (Enter)")

    simulated(put(page_of(session, answered)), refused)
    simulated(put(page_of(session, None)), over)


def test_time_and_effort_are_shown_while_they_are_of_what_is_asked() -> None:
    session = SessionSource()
    session.ask(5, "none", "Contract as hard as you can.")
    session.publish("Countdown", 5, what="mvc", left_s=3.0, of_s=5.0)
    session.publish("EffortBars", 6, fds=0.5, edc=1.2, clipped=True)

    async def look(user: Any) -> None:
        await user.should_see("mvc: 3 s left")
        await user.should_see("clipped: lower the amplifier's gain")
        session.ask(9, "none", "Thank you.")
        await user.should_see("Thank you.")
        await user.should_not_see("mvc: 3 s left")
        await user.should_not_see("clipped")

    simulated(put(page_of(session, None)), look)


@pytest.mark.parametrize("recorded", [False, True])
def test_trials_are_listed_spoilt_ones_too_of_a_bag_up_to_the_chosen_time(recorded: bool) -> None:
    session = SessionSource()
    session.done(500_000_000, 1)
    session.done(2_000_000_000, 1, attempt=2, estimate_m=0.004)
    desk = DeskMonitor(session, recorded=recorded)
    desk.load()
    desk.look()
    both = [(1, "repeat", 0.0), (2, "subject", 0.004)]
    seen = [(one["attempt"], one["ended_by"], one["estimate_m"]) for one in desk.rows]
    assert seen == both[: 1 if recorded else 2]
    session.change(now_s=2.5)
    assert [(one["attempt"], one["ended_by"], one["estimate_m"]) for one in desk.rows] == both


def test_who_asked_last_is_shown_and_an_older_prompt_that_comes_again_is_not() -> None:
    session = SessionSource()
    session.ask(4, "enter", "new")
    desk = DeskMonitor(session)
    desk.look()
    session.ask(2, "enter", "old")
    desk.look()
    assert desk.question is not None
    assert desk.question.text == "new"
