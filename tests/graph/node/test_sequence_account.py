"""The account of an edge: nothing twice, nothing missing without being counted."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.graph.node.sequence_account import SequenceAccount

LENGTH = 30


@settings(deadline=None, max_examples=200)
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


@settings(deadline=None, max_examples=200)
@given(st.lists(st.tuples(st.integers(0, 2), st.integers(1, 8)), max_size=40))
def test_whatever_arrives_is_handed_out_once_and_in_order(arrivals: list[tuple[int, int]]) -> None:
    counter = SequenceAccount()
    handed_out = [arrival for arrival in arrivals if counter.accept(*arrival)]
    assert handed_out == sorted(set(handed_out))
    assert counter.received == len(handed_out)
    assert counter.received + counter.repeated == len(arrivals)
    assert counter.lost >= 0


def test_a_late_joiner_has_lost_nothing() -> None:
    counter = SequenceAccount()
    assert counter.accept(0, 41)
    assert counter.accept(0, 42)
    assert (counter.received, counter.lost) == (2, 0)


def test_a_greeting_starts_the_account_so_that_a_lost_first_message_counts() -> None:
    counter = SequenceAccount()
    counter.heartbeat(0, 40)
    assert counter.accept(0, 42)
    assert (counter.received, counter.lost) == (1, 1)


def test_a_heartbeat_reveals_a_lost_tail_once() -> None:
    counter = SequenceAccount()
    counter.accept(0, 1)
    counter.heartbeat(0, 4)
    counter.heartbeat(0, 4)
    counter.heartbeat(0, 2)
    assert counter.lost == 3
    assert not counter.accept(0, 3)
    assert counter.accept(0, 5)
    assert counter.lost == 3


def test_a_restarted_publisher_is_not_a_repeat() -> None:
    counter = SequenceAccount()
    for sequence in (1, 2, 3):
        counter.accept(0, sequence)
    assert counter.accept(1, 1)
    assert not counter.accept(0, 4)
    assert (counter.received, counter.lost, counter.repeated) == (4, 0, 1)


def test_what_a_restarted_publisher_sent_before_the_reader_was_back_is_lost() -> None:
    for by_heartbeat in (True, False):
        counter = SequenceAccount()
        counter.accept(0, 1)
        if by_heartbeat:
            counter.heartbeat(1, 2)
        assert counter.accept(1, 3)
        assert (counter.received, counter.lost) == (2, 2)


def test_a_heartbeat_of_an_epoch_that_is_over_changes_nothing() -> None:
    counter = SequenceAccount()
    counter.accept(3, 1)
    counter.heartbeat(2, 99)
    assert (counter.epoch, counter.sequence, counter.lost) == (3, 1, 0)
