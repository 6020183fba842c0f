"""The acknowledgement of a stop where it may not be pressed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("nicegui")
pytest.importorskip("nicegui.testing.user_simulation")

from palp_core.palpation.live_page.drawing.strip import _Acknowledge
from palp_core.palpation.live_page.safety import safety_status
from palp_core.view.source.operator import NOT_OPERATED
from tests.support.view.simulated_user import simulated

STOPPED = {"state": "latched", "permits": False, "cause": "operator", "text": "palp view", "warning": ""}


@pytest.mark.parametrize("refusal", ["", NOT_OPERATED])
def test_an_acknowledgement_that_would_be_refused_is_dead_and_says_why(refusal: str) -> None:
    viewer: Any = SimpleNamespace(refusal=lambda **_: refusal, operator=None)
    shown: list[_Acknowledge] = []

    async def look(user: Any) -> None:
        shown[-1].show(safety_status(STOPPED, 0.0))
        assert shown[-1]._press.first.enabled is not bool(refusal)
        if refusal:
            await user.should_see(refusal)

    simulated(lambda: shown.append(_Acknowledge(viewer, "safety")), look)
