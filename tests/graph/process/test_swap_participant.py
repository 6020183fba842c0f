"""A node's part in a swap, without processes."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from palp_core.graph.process import swap_messages, swap_participant
from palp_core.graph.process.channel import ChannelMessage


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
