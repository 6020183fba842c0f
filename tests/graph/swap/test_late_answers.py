"""A swap waits for the answers to what it has asked, whatever else comes."""

from collections import deque
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast, get_type_hints

import pytest

from palp_core.graph.process import swap_messages, swap_participant
from palp_core.graph.process.channel import ChannelMessage
from palp_core.graph.process.swap_messages import FromSwapped, Handover, Working
from palp_core.graph.swap.engine import CHANGE, TABLE, Swap
from palp_core.graph.swap.swap import STEPS, SwapFailed
from tests.support.palp import ROOT


def supervisor_of(said: deque[FromSwapped]) -> Any:
    """A supervisor whose first node says this, one after the other."""
    old = SimpleNamespace(ended=False, handed_over=False, respawn_at_ns=None, replies=[])

    def wait_until(condition: Callable[[], bool], _: int) -> bool:
        while not condition():
            if not said:
                return False
            old.replies.append(said.popleft())
        return True

    return SimpleNamespace(
        processes=[old],
        wait_until=wait_until,
        send_if_connected=lambda *_: None,
        start_ns=0,
    )


def swap_of(said: deque[FromSwapped]) -> Swap:
    """A swap whose old node says this, one after the other."""
    request = SimpleNamespace(node="relay", timeout_s=1.0)
    swap: Any = SimpleNamespace(index=0, request=request, new=SimpleNamespace(inputs={}))
    return Swap(supervisor_of(said), Path(), swap, 0, None)


HAND_OVER = CHANGE[0]


def test_what_was_asked_in_a_swap_before_and_is_answered_now_is_no_answer() -> None:
    wanted = Handover(b"now", 0, {}, {})
    assert swap_of(deque([Working(0.0, 0), wanted])).wait_for_answer(HAND_OVER) is wanted
    with pytest.raises(SwapFailed, match="the old node did not answer"):
        swap_of(deque([Working(0.0, 0)])).wait_for_answer(HAND_OVER)


def test_a_state_that_is_not_moved_in_time_is_named_with_its_size() -> None:
    swap = swap_of(deque([Handover(bytes(60_000_000), 0, {}, {})]))
    swap.take(HAND_OVER)
    with pytest.raises(SwapFailed, match=r"did not answer \(Handover\) within 1 s, with a state of 60 MB"):
        swap.take(HAND_OVER)


def test_the_documented_table_is_the_one_that_is_walked() -> None:
    rows = [
        "| {} | {} | {} | {} | {} | {} |".format(
            step.name,
            step.when,
            step.to,
            getattr(get_type_hints(step.send)["return"], "__name__", "").removeprefix("NoneType"),
            step.awaits.__name__,
            type(step.undo).__name__ if step.undo is not None else "",
        )
        for step in TABLE
    ]
    assert "\n".join(rows) in Path(ROOT, "docs/explanation/swap.md").read_text()
    assert tuple(dict.fromkeys(step.name for step in TABLE if step.name in STEPS)) == STEPS[1:]


def test_a_new_node_waits_for_the_graphs_own_readers_however_late_they_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def nothing(*_: object) -> None: ...

    publisher = SimpleNamespace(hold=nothing, beats=True, readers={"/p/o": 1}, named_readers={"quick"})
    said: list[ChannelMessage] = []
    participant = swap_participant.SwapParticipant(
        cast(Any, None), cast(Any, SimpleNamespace(publisher=publisher, poll=nothing)), said.append, 0,
        successor=True,
    )  # fmt: skip
    now_ns = 0
    monkeypatch.setattr(swap_participant, "monotonic_ns", lambda: now_ns)
    participant.handle(swap_messages.AwaitReaders({"/p/o": 3}, ["quick", "late"]))
    now_ns = 60_000_000_000
    participant.turn()
    assert participant.waiting
    assert not said
    publisher.readers["/p/o"], publisher.named_readers = 2, {"quick", "late"}
    participant.turn()
    assert said == [swap_messages.ReadersReady()]  # without a tool, which can ask for what it missed
    assert not participant.waiting
