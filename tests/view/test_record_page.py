"""The page of recordings without a browser."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("nicegui")
pytest.importorskip("nicegui.testing.user_simulation")

from nicegui import ui

from palp_core.errors import BagError
from palp_core.view.pages.record import record_page, state_of
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.recordings import IN_SIMULATED_TIME
from tests.support.view.simulated_user import simulated
from tests.view.test_pages import Told


def test_in_simulated_time_the_buttons_are_dead_and_it_says_why() -> None:
    recordings: Any = SimpleNamespace(folder=Path("bags"), cannot=IN_SIMULATED_TIME, all=[])

    async def look(user: Any) -> None:
        await user.should_see(IN_SIMULATED_TIME)
        for word in ("record", "write snapshot"):
            (button,) = user.find(kind=ui.button, content=word).elements
            assert not button.enabled

    simulated(lambda: record_page(Viewer(source=Told()), recordings), look)


def test_of_a_recorder_that_does_not_end_nobody_says_that_it_has_ended() -> None:
    def stop(_: object) -> None:
        raise BagError("the recorder of bags/b does not end")

    one = SimpleNamespace(out=Path("bags/b"), running=True, made=True, snapshot_s=0.0, words=[])
    recordings: Any = SimpleNamespace(folder=Path("bags"), cannot="", all=[one], stop=stop)

    async def look(user: Any) -> None:
        await user.should_see("under way")
        user.find(kind=ui.button, content="stop").click()
        await user.should_see("the recorder of bags/b does not end")
        await user.should_not_see("has ended")

    simulated(lambda: record_page(Viewer(source=Told()), recordings), look)


@pytest.mark.parametrize(
    ("running", "made", "complete", "words"),
    [
        (True, False, None, "it starts"),
        (True, True, None, "under way"),
        (False, True, True, "whole: nothing is missing"),
        (False, True, False, "something is missing"),
        (False, False, False, "refused: there is no bag of it"),
    ],
)
def test_a_refusal_is_not_told_as_something_missing(
    running: bool, made: bool, complete: bool | None, words: str
) -> None:
    one: Any = SimpleNamespace(running=running, made=made, complete=complete, snapshot_s=0.0)
    assert state_of(one)[0] == words
