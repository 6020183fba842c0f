"""The latency histogram against sorted durations."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.runtime.latency import Latency


@settings(deadline=None, max_examples=200)
@given(
    st.lists(st.integers(0, 10**15), min_size=1, max_size=200),
    st.sampled_from([1.0, 50.0, 90.0, 99.0, 100.0]),
)
def test_a_percentile_is_at_most_six_per_cent_above_the_true_one(
    durations: list[int], percent: float
) -> None:
    latency = Latency()
    for duration_ns in durations:
        latency.add(duration_ns)
    rank = max(-(-len(durations) * percent // 100.0), 1.0)
    true_ns = sorted(durations)[int(rank) - 1]
    assert true_ns <= latency.percentile_s(percent) * 1e9 * (1 + 1e-12) + 1e-6
    assert latency.percentile_s(percent) * 1e9 <= 1.0626 * true_ns + 1.0
    assert latency.summary_s()["max"] == max(durations) / 1e9


def test_nothing_added_is_zero_and_a_clock_ahead_counts_as_no_time() -> None:
    latency = Latency()
    assert latency.summary_s() == {"p50": 0.0, "p90": 0.0, "p99": 0.0, "max": 0.0}
    latency.add(-5)
    assert latency.count == 1
    assert latency.percentile_s(50.0) == 0.0
