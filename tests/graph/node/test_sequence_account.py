"""The account of an edge: nothing twice, nothing missing without being counted."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.graph.latency import BATCH, LONGEST_NS, RECENT, Latency
from palp_core.graph.node.sequence_account import SequenceAccount

LENGTH = 30


@given(st.lists(st.booleans(), min_size=LENGTH, max_size=LENGTH), st.data())
def test_received_and_lost_add_up_to_the_last_sequence(arrives: list[bool], data: st.DataObject) -> None:
    counter = SequenceAccount()
    counter.heartbeat(0, 0)
    handed_out = []
    for sequence, arrived in enumerate(arrives, start=1):
        if arrived and counter.accept(0, sequence):
            handed_out.append(sequence)
        if data.draw(st.booleans()):
            counter.heartbeat(0, data.draw(st.integers(0, sequence)))
        assert counter.received + counter.lost == counter.sequence
    counter.heartbeat(0, LENGTH)
    assert counter.received == len(handed_out) == sum(arrives)
    assert counter.received + counter.lost == LENGTH


@given(st.lists(st.tuples(st.integers(0, 2), st.integers(1, 8)), max_size=40))
def test_whatever_arrives_is_handed_out_once_and_in_order(arrivals: list[tuple[int, int]]) -> None:
    counter = SequenceAccount()
    handed_out = [arrival for arrival in arrivals if counter.accept(*arrival)]
    assert handed_out == sorted(set(handed_out))
    assert counter.received == len(handed_out)
    assert counter.received + counter.repeated == len(arrivals)
    assert counter.lost >= 0


MESSAGE, BEAT = "accept", "heartbeat"


@pytest.mark.parametrize(
    ("arrivals", "received", "lost", "repeated"),
    [
        pytest.param([(MESSAGE, 0, 41), (MESSAGE, 0, 42)], 2, 0, 0, id="a late joiner has lost nothing"),
        pytest.param([(BEAT, 0, 40), (MESSAGE, 0, 42)], 1, 1, 0, id="after a greeting the first one counts"),
        pytest.param(
            [(MESSAGE, 0, 1), (BEAT, 0, 4), (BEAT, 0, 4), (BEAT, 0, 2), (MESSAGE, 0, 3), (MESSAGE, 0, 5)],
            2, 3, 1, id="a heartbeat reveals a lost tail once",
        ),
        pytest.param(
            [(MESSAGE, 0, 1), (MESSAGE, 0, 2), (MESSAGE, 1, 1), (MESSAGE, 0, 3)],
            3, 0, 1, id="a restarted publisher is not a repeat",
        ),
        pytest.param([(MESSAGE, 0, 1), (MESSAGE, 1, 3)], 2, 2, 0, id="lost before the reader was back"),
        pytest.param([(MESSAGE, 0, 1), (BEAT, 1, 2), (MESSAGE, 1, 3)], 2, 2, 0, id="so a heartbeat says"),
        pytest.param([(MESSAGE, 3, 1), (BEAT, 2, 99)], 1, 0, 0, id="an epoch that is over changes nothing"),
    ],
)  # fmt: skip
def test_arrivals_are_accounted_for(
    arrivals: list[tuple[str, int, int]], received: int, lost: int, repeated: int
) -> None:
    counter = SequenceAccount()
    for what, epoch, sequence in arrivals:
        getattr(counter, what)(epoch, sequence)
    assert (counter.received, counter.lost, counter.repeated) == (received, lost, repeated)


def latency_of(durations: list[int]) -> Latency:
    latency = Latency()
    for duration_ns in durations:
        latency.add(duration_ns)
    return latency


@given(st.lists(st.integers(0, 10**15), min_size=1, max_size=200), st.sampled_from([1.0, 50.0, 90.0, 100.0]))
def test_a_percentile_is_at_most_six_per_cent_above_the_true_one(
    durations: list[int], percent: float
) -> None:
    latency = latency_of(durations)
    rank = max(-(-len(durations) * percent // 100.0), 1.0)
    true_ns = sorted(durations)[int(rank) - 1]
    assert true_ns <= latency.percentile_s(percent) * 1e9 * (1 + 1e-12) + 1e-6
    assert latency.percentile_s(percent) * 1e9 <= 1.0626 * true_ns + 1.0
    assert latency.summary_s()["max"] == max(durations) / 1e9


@given(st.lists(st.integers(-5, 10**12), max_size=3 * BATCH), st.integers(1, 2 * RECENT))
def test_the_last_ones_are_known_one_by_one(durations: list[int], window: int) -> None:
    last = sorted(max(duration_ns, 0) for duration_ns in durations[-window:])
    found = latency_of(durations).recent_s(window)
    assert found["messages"] == len(last)
    assert (found["min"], found["max"]) == ((last[0] / 1e9, last[-1] / 1e9) if last else (0.0, 0.0))
    assert found["mean"] == pytest.approx(np.mean(last) / 1e9 if last else 0.0)
    assert found["std"] == pytest.approx(np.std(last) / 1e9 if last else 0.0, abs=1e-9)
    rank = np.percentile(last, 90, method="inverted_cdf") / 1e9 if last else 0.0
    assert found["p90"] == pytest.approx(rank)


def test_what_no_clock_can_show_counts_as_nothing_or_the_longest_and_few_are_kept() -> None:
    assert set(Latency().summary_s().values()) == {0.0}
    latency = latency_of([2**80, -(2**80), 5])
    assert (latency.count, latency.max_ns, latency.percentile_s(1.0)) == (3, LONGEST_NS, 1e-9)
    found = latency_of(list(range(5 * RECENT))).recent_s(10**9)
    assert (found["messages"], found["min"]) == (RECENT, 4 * RECENT / 1e9)


@settings(max_examples=50)
@given(st.lists(st.integers(-5, 2**63), min_size=1, max_size=200))
def test_looking_after_each_one_or_once_at_the_end_is_the_same(durations: list[int]) -> None:
    often, once = Latency(), latency_of(durations)
    for duration_ns in durations:
        often.add(duration_ns)
        often.summary_s()
    assert often.summary_s() == once.summary_s()
    assert often.recent_s(RECENT) == once.recent_s(RECENT)
