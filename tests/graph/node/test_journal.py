"""What a node consumes is written down: all of it in lockstep, on the wall clock for whoever follows."""

from typing import Any

import pytest

from palp_core.graph.messages.builtin import Order
from palp_core.graph.node.journal import BATCH, Journal
from palp_core.graph.node.lifecycle import Transition

STATE = b"state"


class Stand(Journal):
    """A journal whose publisher remembers what was published."""

    def __init__(self, *, has_readers: bool = True, greeted_count: int = 0) -> None:
        self.has_readers, self.greeted_count = has_readers, greeted_count
        self.batches: list[Order] = []
        publisher: Any = self
        super().__init__(publisher, ["timer:tick"], lambda: STATE)

    def put(self, batch: Order) -> None:
        self.batches.append(batch)

    def tick(self, k: int) -> None:
        self.note("timer:tick", 0, k, k)

    @property
    def written(self) -> list[tuple[list[str], bytes]]:
        return [([batch.sources[at] for at in batch.source], batch.hand_over) for batch in self.batches]


@pytest.fixture
def unread() -> Stand:
    made = Stand(has_readers=False)
    made.note_transition(Transition.ACTIVATE, 1)
    return made


def test_a_follower_from_the_start_has_all_of_it_from_the_activation_to_the_shutdown() -> None:
    log = Stand()
    assert not log.note_transition(Transition.CONFIGURE, 0)
    assert log.note_transition(Transition.ACTIVATE, 1)
    log.serve_follower(1, active=True)
    log.tick(1)
    log.serve_follower(2, active=True)
    assert not log.note_transition(Transition.SHUTDOWN, 3)
    log.flush(3)
    assert log.written == [(["activate"], b""), (["timer:tick"], b""), (["shutdown"], b"")]


def test_a_follower_that_comes_later_begins_with_the_nodes_state(unread: Stand) -> None:
    for k in range(3):
        unread.tick(k)
        unread.serve_follower(k, active=True)
    unread.has_readers = True
    unread.serve_follower(4, active=False)  # between two lives it has no state to begin with
    assert not any(batch.hand_over for batch in unread.batches)
    unread.serve_follower(5, active=True)
    unread.tick(9)
    unread.serve_follower(6, active=True)
    assert unread.written[-1] == (["timer:tick"], STATE)
    assert list(unread.batches[-1].sequence) == [9]


def test_a_second_follower_gets_a_place_to_start_and_the_first_loses_nothing() -> None:
    log = Stand(greeted_count=1)
    log.note_transition(Transition.ACTIVATE, 1)
    log.tick(2)
    log.greeted_count = 2
    log.serve_follower(2, active=True)
    log.tick(3)
    log.serve_follower(3, active=True)
    assert log.written == [(["activate", "timer:tick"], b""), (["timer:tick"], STATE)]


@pytest.mark.parametrize(("has_readers", "published"), [(True, 0), (False, 1)])
def test_a_full_batch_is_published_unless_a_new_follower_could_not_place_it(
    unread: Stand, *, has_readers: bool, published: int
) -> None:
    unread.has_readers = has_readers
    for k in range(BATCH - 1):
        assert unread.batches == []
        unread.tick(k)
    assert len(unread.batches) == published


def test_a_node_that_takes_over_goes_on_for_the_followers_of_the_one_before() -> None:
    log = Stand()
    log.take_snapshot(7)
    log.tick(8)
    log.serve_follower(8, active=True)
    assert log.written == [(["timer:tick"], STATE)]
    assert log.note_transition(Transition.DEACTIVATE, 9)
