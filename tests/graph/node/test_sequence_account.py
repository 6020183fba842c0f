"""The account of an edge: nothing twice, nothing missing without being counted."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

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
