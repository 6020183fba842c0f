"""An edge on the wall clock under loss, disorder, repetition, restarts and silence."""

from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palp_core.graph.messages.frame import Frame, Kind, pack_former
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.transport.reorder_buffer import FILL_NS, SUCCESSOR_NS, ReorderBuffer
from tests.support.palp import Palp
from tests.support.post import Post

TOPIC = "/p/x"


def frame(sequence: int, epoch: int = 0, kind: int = Kind.DATA, stamp_ns: int = 0) -> Frame:
    return Frame(TOPIC, kind, epoch, sequence, stamp_ns, 0, memoryview(b"x"))


class Edge:
    """A buffer with the node's account behind it and a publisher that remembers ``depth`` messages."""

    def __init__(self, qos: Qos, *, answers: bool = True, counter: SequenceAccount | None = None) -> None:
        self.account = counter or SequenceAccount()
        self.taken: list[int] = []
        self.asked: list[tuple[int, int]] = []
        self.kept: list[Frame] = []
        self.epoch = 0
        self.answers = answers
        self.now_ns = 0
        self.buffer = ReorderBuffer(TOPIC, qos, self.account, self._deliver, self._ask)

    def _deliver(self, frame: Frame) -> None:
        if frame.kind != Kind.DATA:
            self.account.heartbeat(frame.epoch, frame.sequence)
        elif self.account.accept(frame.epoch, frame.sequence):
            self.taken.append(frame.sequence)

    def _ask(self, topic: str, first: int, last: int) -> None:
        assert topic == TOPIC
        self.asked.append((first, last))

    def publish(self, depth: int, sequence: int) -> Frame:
        made = frame(sequence, self.epoch)
        self.kept = [*self.kept, made][-depth:]
        return made

    def arrive(self, *frames: Frame) -> None:
        for one in frames:
            self.buffer.arrive(one, self.now_ns)
            self.answer()

    def answer(self) -> None:
        while self.asked and self.answers:
            first, last = self.asked.pop(0)
            found = [one for one in self.kept if first <= one.sequence <= last]
            self.buffer.fill(self.epoch, found, self.now_ns)

    def wait(self, duration_ns: int) -> None:
        self.now_ns += duration_ns
        self.buffer.expire(self.now_ns)
        self.answer()


RELIABLE = Qos(depth=5)


@given(st.lists(st.sampled_from(["pass", "drop", "twice", "late", "beat"]), max_size=60), st.integers(1, 8))
def test_a_reliable_edge_loses_nothing_that_the_publisher_still_has(fates: list[str], depth: int) -> None:
    edge = Edge(Qos(depth=depth))
    edge.arrive(frame(0, kind=Kind.HEARTBEAT))
    delayed: list[Frame] = []
    for sequence, fate in enumerate(fates, start=1):
        made = edge.publish(depth, sequence)
        if fate in ("pass", "twice"):
            edge.arrive(*[made] * (1 + (fate == "twice")), *delayed)
            delayed.clear()
        elif fate == "late":
            delayed.append(made)
        elif fate == "beat":
            edge.arrive(frame(sequence, kind=Kind.HEARTBEAT))
    last = len(fates)
    edge.arrive(frame(last, kind=Kind.HEARTBEAT))
    assert edge.taken == sorted(set(edge.taken))
    assert set(range(max(last - depth, 0) + 1, last + 1)) <= set(edge.taken)
    assert edge.account.received == len(edge.taken)
    assert edge.account.received + edge.account.lost == last
    assert edge.buffer.give_up_ns is None


@given(st.lists(st.sampled_from(["pass", "drop", "beat"]), max_size=40))
def test_a_best_effort_edge_asks_for_nothing_and_counts_exactly(fates: list[str]) -> None:
    edge = Edge(Qos(reliability="best_effort"))
    edge.arrive(frame(0, kind=Kind.HEARTBEAT))
    for sequence, fate in enumerate(fates, start=1):
        if fate != "drop":
            edge.arrive(frame(sequence, kind=Kind.DATA if fate == "pass" else Kind.HEARTBEAT))
    edge.arrive(frame(len(fates), kind=Kind.HEARTBEAT))
    assert not edge.asked
    assert edge.taken == [n for n, fate in enumerate(fates, start=1) if fate == "pass"]
    assert edge.account.lost == sum(fate != "pass" for fate in fates)


def test_what_comes_after_a_gap_waits_for_it() -> None:
    edge = Edge(RELIABLE, answers=False)
    edge.arrive(frame(0, kind=Kind.HEARTBEAT), frame(1), frame(3), frame(4))
    assert edge.taken == [1]
    assert edge.asked == [(2, 2)]
    edge.kept = [frame(2)]
    edge.answers = True
    edge.answer()
    assert edge.taken == [1, 2, 3, 4]
    assert (edge.account.lost, edge.buffer.filled) == (0, 1)


def test_a_publisher_that_does_not_answer_is_waited_for_and_then_the_gap_is_counted() -> None:
    edge = Edge(RELIABLE, answers=False)
    edge.arrive(frame(0, kind=Kind.HEARTBEAT), frame(1), frame(4))
    edge.wait(FILL_NS - 1)
    assert edge.taken == [1]
    edge.wait(1)
    assert edge.taken == [1, 4]
    assert edge.account.lost == 2


@pytest.mark.parametrize("reliability", ["reliable", "best_effort"])
def test_what_a_place_could_not_deliver_before_it_died_is_asked_of_its_successor(
    reliability: Literal["reliable", "best_effort"],
) -> None:
    edge = Edge(Qos(depth=5, reliability=reliability), answers=False)
    edge.arrive(frame(0, kind=Kind.HEARTBEAT), frame(1))
    edge.buffer.begin_move()
    edge.arrive(frame(3))
    edge.wait(FILL_NS)
    assert edge.asked == [(2, 2)]
    edge.arrive(frame(4))
    assert edge.taken == [1]
    edge.kept, edge.answers = [frame(2)], True
    edge.answer()
    assert edge.taken == [1, 2, 3, 4]
    assert edge.account.lost == 0


def test_a_best_effort_reader_that_the_successor_cannot_help_goes_on() -> None:
    edge = Edge(Qos(depth=5, reliability="best_effort"), answers=False)
    edge.arrive(frame(0, kind=Kind.HEARTBEAT), frame(1))
    edge.buffer.begin_move()
    edge.arrive(frame(3))
    edge.buffer.end_move(edge.now_ns, 4)
    edge.wait(FILL_NS + SUCCESSOR_NS - 1)
    assert edge.taken == [1]
    edge.wait(1)
    assert edge.taken == [1, 3]
    edge.arrive(frame(6))
    assert edge.taken == [1, 3, 6]
    assert edge.account.lost == 3


def test_a_reader_that_was_away_still_waits_for_the_answer_and_blames_nobody() -> None:
    edge = Edge(RELIABLE, answers=False)
    edge.arrive(frame(0, kind=Kind.HEARTBEAT), frame(1), frame(3))
    edge.now_ns += 5 * FILL_NS  # stopped, or in one long handler, while the answer came
    edge.buffer.excuse_absence(5 * FILL_NS, edge.now_ns)
    edge.wait(0)
    assert edge.buffer.heard_ns == edge.buffer.data_ns == edge.now_ns
    edge.kept, edge.answers = [frame(2)], True
    edge.answer()
    assert edge.taken == [1, 2, 3]
    assert edge.account.lost == 0


def test_a_late_joiner_of_a_latched_edge_gets_the_last_messages_first() -> None:
    edge = Edge(Qos(durability="transient_local", depth=3), answers=False)
    edge.kept = [frame(n) for n in range(5, 10)]
    edge.arrive(frame(9, kind=Kind.HEARTBEAT), frame(10))
    assert edge.taken == []
    assert not edge.buffer.matched
    edge.answers = True
    edge.answer()
    assert edge.taken == [7, 8, 9, 10]
    assert edge.account.lost == 0
    assert edge.buffer.matched


def test_a_late_joiner_of_a_volatile_edge_begins_with_what_comes() -> None:
    edge = Edge(RELIABLE)
    edge.arrive(frame(9, kind=Kind.HEARTBEAT), frame(10))
    assert edge.taken == [10]
    assert edge.account.lost == 0


def test_a_restarted_reader_goes_on_where_its_predecessor_stopped() -> None:
    edge = Edge(RELIABLE, counter=SequenceAccount(epoch=0, sequence=4))
    edge.kept = [frame(n) for n in range(7, 12)]
    edge.arrive(frame(11, kind=Kind.HEARTBEAT))
    assert edge.taken == [7, 8, 9, 10, 11]
    assert edge.account.lost == 2


def test_a_restarted_publisher_is_followed_from_its_first_message() -> None:
    edge = Edge(RELIABLE)
    edge.arrive(frame(0, kind=Kind.HEARTBEAT), frame(1), frame(2))
    edge.epoch = 1
    edge.kept = [frame(n, epoch=1) for n in (1, 2, 3)]
    edge.arrive(frame(3, epoch=1))
    assert edge.taken == [1, 2, 1, 2, 3]
    assert (edge.account.lost, edge.account.repeated) == (0, 0)
    edge.arrive(frame(3, epoch=0))
    assert edge.account.repeated == 1


def test_an_answer_of_an_epoch_that_is_over_is_no_answer() -> None:
    edge = Edge(RELIABLE, answers=False)
    edge.arrive(frame(0, kind=Kind.HEARTBEAT), frame(2))
    edge.buffer.fill(7, [frame(1, epoch=7)], 0)
    assert edge.taken == []
    edge.wait(FILL_NS)
    assert edge.taken == [2]


def test_replies_are_handed_on_as_they_come() -> None:
    edge = Edge(RELIABLE)
    edge.buffer = ReorderBuffer(TOPIC, RELIABLE, edge.account, edge._deliver, edge._ask, ordered=False)
    edge.arrive(frame(3), frame(9))
    assert edge.taken == [3, 9]
    assert not edge.asked


def test_latency_is_known_once_the_graph_has_started() -> None:
    edge = Edge(RELIABLE)
    edge.now_ns = 1_000_000
    edge.arrive(frame(1))
    assert edge.buffer.latency.count == 0
    edge.buffer.origin_ns = 400_000
    edge.arrive(frame(2, stamp_ns=100_000))
    assert edge.buffer.latency.max_ns == 500_000


@pytest.mark.parametrize("reliability", ["reliable", "best_effort"])
def test_what_a_killed_publisher_could_not_deliver_is_counted(
    reliability: Literal["reliable", "best_effort"],
) -> None:
    edge = Edge(Qos(reliability=reliability))
    told = frame(0, epoch=1, kind=Kind.HEARTBEAT)._replace(payload=memoryview(pack_former(0, 9)))
    edge.arrive(*(edge.publish(10, sequence) for sequence in (1, 2, 3)), told)
    assert edge.account.lost == 6
    edge.arrive(told, frame(1, epoch=1))
    assert (edge.account.lost, edge.account.received, edge.account.epoch) == (6, 4, 1)


def test_only_the_process_that_the_reader_heard_is_counted() -> None:
    told = frame(0, epoch=2, kind=Kind.HEARTBEAT)._replace(payload=memoryview(pack_former(1, 9)))
    for before in ([], [frame(1, epoch=0)]):  # nothing, or a process before that one
        edge = Edge(Qos())
        edge.arrive(*before, told)
        assert edge.account.lost == 0
    edge.arrive(frame(0, epoch=3, kind=Kind.HEARTBEAT)._replace(payload=memoryview(b"garbage")))
    assert edge.account.epoch == 3


ALL = list(range(1, 501))


@pytest.fixture
def post(palp: Palp, tmp_path: Path) -> Post:
    return Post(palp, tmp_path)


def test_a_killed_reader_goes_on_where_it_was_and_misses_nothing(post: Post) -> None:
    post.deliver("many", "kill")
    letters = post.letters()
    assert letters[:100] == ALL[:100]
    assert letters[100:] in (ALL[100:], [100, *ALL[100:]])  # the letter at which it died may come again
    assert post.account()["lost"] == 0


def test_a_killed_reader_knows_exactly_how_much_it_missed_beyond_the_depth(post: Post) -> None:
    post.deliver("few", "kill", f"until:={post.out}.back")
    letters = post.letters()
    assert letters == sorted(set(letters))
    missed = set(range(1, letters[-1] + 1)) - set(letters)
    assert missed == set(range(101, 101 + len(missed)))
    interrupted = 1  # letter 100 was not done with when the reader died, and is no longer kept
    assert post.account()["lost"] == len(missed) + interrupted == post.lost_by_event()


def test_a_robbed_reader_has_all_of_it_in_order(post: Post) -> None:
    post.deliver("many", "rob")
    assert post.letters() == ALL
    assert post.account()["lost"] == 0
