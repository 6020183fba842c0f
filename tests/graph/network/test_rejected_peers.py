"""Strangers are counted without end, remembered within bounds, and spoken of now and then."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.graph.network.rejected_peers import BURST, MOST_ENTRIES, PERIOD_NS, RejectedPeers


def test_a_stranger_that_insists_is_said_at_powers_of_two() -> None:
    refusals = RejectedPeers()
    said = [refusals.note("1.2.3.4", "k", "why", k * PERIOD_NS) for k in range(1, 101)]
    assert [k for k, entry in enumerate(said, start=1) if entry is not None] == [1, 2, 4, 8, 16, 32, 64]
    assert refusals.total_count == 100
    (entry,) = refusals.latest()
    assert entry.count == 100
    assert "1.2.3.4" in str(entry)
    assert "(100 times)" in str(entry)


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 2000), st.integers(1, 100))
def test_many_strangers_take_bounded_memory_and_lines(count: int, seconds: int) -> None:
    refusals = RejectedPeers()
    lines = sum(
        refusals.note(f"10.0.{k >> 8}.{k & 255}", str(k), "why", PERIOD_NS + k * seconds * PERIOD_NS // count)
        is not None
        for k in range(count)
    )
    assert refusals.total_count == count
    assert len(refusals.latest()) == min(count, MOST_ENTRIES)
    assert lines <= BURST + seconds
