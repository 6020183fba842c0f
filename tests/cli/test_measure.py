"""Rates come from the publisher's own numbers, whatever the listener missed and whenever it woke."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.cli.topic.measure import Window
from palp_core.graph.discovery.topic_reader import ReceivedFrame
from palp_core.graph.messages.frame import Kind, pack, parse


def received(
    sequence: int, stamp_ns: int, *, epoch: int = 0, arrived_ns: int = 0, lost: int = 0
) -> ReceivedFrame:
    return ReceivedFrame(
        parse(pack(b"/a/b", Kind.DATA, epoch, sequence, stamp_ns, 1, b"xyz")), arrived_ns, lost
    )


@settings(max_examples=50)
@given(
    period_ns=st.integers(1_000, 10**9),
    missing=st.sets(st.integers(2, 28), max_size=20),
    delays_ns=st.lists(st.integers(0, 10**8), min_size=30, max_size=30),
)
def test_what_the_listener_missed_does_not_change_the_rate(
    period_ns: int, missing: set[int], delays_ns: list[int]
) -> None:
    window = Window(100)
    for sequence in range(1, 30):
        if sequence not in missing:
            at_ns = sequence * period_ns
            window.add(received(sequence, at_ns, arrived_ns=at_ns + delays_ns[sequence]))
    assert window.rates_hz()[0] == pytest.approx(1e9 / period_ns)
    assert window.messages == 29


def test_periods_are_of_neighbours_only_and_a_window_forgets_what_is_older() -> None:
    window = Window(3)
    window.add(received(1, -(10**12)))
    for sequence, stamp_ns in ((2, 0), (3, 10_000_000), (8, 70_000_000), (9, 90_000_000)):
        window.add(received(sequence, stamp_ns))
    periods = window.periods_s()
    assert (periods["min_period_s"], periods["max_period_s"]) == (0.01, 0.02)
    assert periods["std_period_s"] == pytest.approx(0.005)
    assert (window.full, window.messages) == (True, 8)


def test_a_restarted_publisher_begins_a_new_window_and_a_heartbeat_is_no_message() -> None:
    window = Window(10)
    window.add(received(500, 10**9, lost=3))
    window.add(received(1, 2 * 10**9, epoch=1))
    assert (window.messages, window.lost) == (1, 0)
    window.add(ReceivedFrame(parse(pack(b"/a/b", Kind.HEARTBEAT, 1, 7, 0, 1)), 0, 6))
    assert (window.messages, window.lost) == (1, 6)
    window.add(received(2, 2 * 10**9, epoch=1))
    assert window.rates_hz() == (None, None)  # messages of one instant
    assert window.points[0].size_bytes == len(pack(b"/a/b", Kind.DATA, 0, 1, 0, 1, b"xyz"))
