"""What a node consumes is written down: all of it in lockstep, on the wall clock for whoever follows."""

from __future__ import annotations

from typing import Any

from palp_core.graph.messages.builtin import Order
from palp_core.graph.node.journal import BATCH, Journal
from palp_core.graph.node.lifecycle import Transition


class PublisherEnd:
    """Remembers what was published."""

    def __init__(self) -> None:
        self.has_readers = True
        self.greeted_count = 0
        self.batches: list[Order] = []

    def put(self, batch: Order) -> None:
        self.batches.append(batch)


def log_of(publisher: Any) -> Journal:
    return Journal(publisher, ["timer:tick"], lambda: b"state")


def entries(batch: Order) -> list[str]:
    return [batch.sources[index] for index in batch.source]


def test_a_follower_from_the_start_has_all_of_it_from_the_activation_to_the_shutdown() -> None:
    publisher = PublisherEnd()
    log = log_of(publisher)
    assert not log.note_transition(Transition.CONFIGURE, 0)
    assert log.note_transition(Transition.ACTIVATE, 1)
    log.serve_follower(1, active=True)
    log.note("timer:tick", 0, 1, 2)
    log.serve_follower(2, active=True)
    assert not log.note_transition(Transition.SHUTDOWN, 3)
    log.flush(3)
    assert [entries(batch) for batch in publisher.batches] == [["activate"], ["timer:tick"], ["shutdown"]]
    assert not any(batch.hand_over for batch in publisher.batches)


def test_a_follower_that_comes_later_begins_with_the_nodes_state() -> None:
    publisher = PublisherEnd()
    publisher.has_readers = False
    log = log_of(publisher)
    log.note_transition(Transition.ACTIVATE, 1)
    for k in range(3):
        log.note("timer:tick", 0, k, k)
        log.serve_follower(k, active=True)
    publisher.has_readers = True
    log.serve_follower(4, active=False)  # between two lives it has no state to begin with
    assert not any(batch.hand_over for batch in publisher.batches)
    log.serve_follower(5, active=True)
    log.note("timer:tick", 0, 9, 6)
    log.serve_follower(6, active=True)
    assert publisher.batches[-1].hand_over == b"state"
    assert entries(publisher.batches[-1]) == ["timer:tick"]
    assert list(publisher.batches[-1].sequence) == [9]


def test_a_second_follower_gets_a_place_to_start_and_the_first_loses_nothing() -> None:
    publisher = PublisherEnd()
    publisher.greeted_count = 1
    log = log_of(publisher)
    log.note_transition(Transition.ACTIVATE, 1)
    log.note("timer:tick", 0, 1, 2)
    publisher.greeted_count = 2
    log.serve_follower(2, active=True)
    log.note("timer:tick", 0, 2, 3)
    log.serve_follower(3, active=True)
    assert [(entries(batch), batch.hand_over) for batch in publisher.batches] == [
        (["activate", "timer:tick"], b""),
        (["timer:tick"], b"state"),
    ]


def test_a_follower_is_told_nothing_that_it_cannot_place() -> None:
    publisher = PublisherEnd()
    publisher.has_readers = False
    log = log_of(publisher)
    log.note_transition(Transition.ACTIVATE, 1)
    publisher.has_readers = True
    for k in range(BATCH):
        log.note("timer:tick", 0, k, k)
    assert publisher.batches == []


def test_with_nobody_following_a_batch_is_kept_until_it_is_full() -> None:
    publisher = PublisherEnd()
    publisher.has_readers = False
    log = log_of(publisher)
    log.note_transition(Transition.ACTIVATE, 1)
    for k in range(BATCH - 2):
        log.note("timer:tick", 0, k, k)
        log.serve_follower(k, active=True)
    assert publisher.batches == []
    log.note("timer:tick", 0, BATCH, BATCH)
    assert len(publisher.batches) == 1


def test_a_node_that_takes_over_goes_on_for_the_followers_of_the_one_before() -> None:
    publisher = PublisherEnd()
    log = log_of(publisher)
    log.take_snapshot(7)
    log.note("timer:tick", 0, 8, 8)
    log.serve_follower(8, active=True)
    assert [batch.hand_over for batch in publisher.batches] == [b"state"]
    assert log.note_transition(Transition.DEACTIVATE, 9)
