"""A swap waits for the answers to what it has asked, whatever else comes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from palp_core.graph.process.swap_messages import Commit, FromSwapped, HandedIn, Working
from palp_core.graph.supervision.process_probation import ProcessProbation
from palp_core.graph.swap.process_swap import _ProcessSwap
from palp_core.graph.swap.swap import SwapFailed


def supervisor_of(said: deque[FromSwapped]) -> Any:
    """A supervisor whose first node says this, one after the other."""
    replies: dict[int, FromSwapped] = {}

    def wait_until(condition: Callable[[], bool], _: int) -> bool:
        while not condition():
            if not said:
                return False
            replies[0] = said.popleft()
        return True

    old = SimpleNamespace(ended=False, handed_over=False, respawn_at_ns=None)
    return SimpleNamespace(
        processes=[old], swap_replies=replies, wait_until=wait_until, send_if_connected=lambda *_: None
    )


def swap_of(said: deque[FromSwapped]) -> _ProcessSwap:
    """A swap whose old node says this, one after the other."""
    swap: Any = SimpleNamespace(index=0, request=SimpleNamespace(node="relay", timeout_s=1.0))
    return _ProcessSwap(supervisor_of(said), Path(), swap, 0, None)  # type: ignore[arg-type]


def test_what_was_asked_in_a_swap_before_and_is_answered_now_is_no_answer() -> None:
    wanted = HandedIn(b"now", 0, {}, {})
    assert swap_of(deque([Working({}), wanted]))._reply_of_old(HandedIn) is wanted
    with pytest.raises(SwapFailed, match="the old node did not answer"):
        swap_of(deque([Working({})]))._reply_of_old(HandedIn)


def test_a_state_that_is_not_moved_in_time_is_named_with_its_size() -> None:
    swap = swap_of(deque([HandedIn(bytes(60_000_000), 0, {}, {})]))
    swap._request_hand_over({}, pause=False)
    with pytest.raises(SwapFailed, match=r"did not answer \(HandedIn\) within 1 s, with a state of 60 MB"):
        swap._request_hand_over({}, pause=False)


def test_nor_is_it_one_to_a_probation_in_lockstep() -> None:
    def reported(*said: FromSwapped) -> tuple[Commit | None, str]:
        probation = ProcessProbation(supervisor_of(deque(said)), None, 0, (), 3, way_back=True)  # type: ignore[arg-type]
        return probation._report(), probation.failure

    wanted = Commit(b"", [], 1, 1, "handler")
    assert reported(Working({}), wanted) == (wanted, "")
    commit, failure = reported(Working({}))
    assert commit is None
    assert "did not return" in failure
