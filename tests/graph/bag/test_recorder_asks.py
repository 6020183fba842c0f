"""A recorder says what it misses when it shows, takes what it is given later, and takes it once."""

from pathlib import Path
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.graph.bag.account import EpochAccount
from palp_core.graph.bag.recorder import BagRecorder
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.frame import Kind, pack

TOPIC = "/policy/mode"


def mode(kit: Any, sequence: int, **options: Any) -> bytes:
    raw: bytes = kit.frame(TOPIC, kit.Mode(stamp_ns=sequence, level=0.0), sequence, 10, **options)
    return raw


def test_each_gap_is_said_once_and_a_heartbeat_tells_of_a_lost_tail(tmp_path: Path, kit: Any) -> None:
    recorder = BagRecorder(BagWriter(tmp_path / "run"), kit.TOPICS)
    said: list[tuple[str, int, int, int]] = []
    recorder.missed = lambda *gap: said.append(gap)
    for sequence in (3, 4, 7):
        recorder(0, mode(kit, sequence))
    for _ in range(2):
        recorder(0, mode(kit, 9, kind=Kind.HEARTBEAT))
    recorder(0, mode(kit, 2, epoch=1))
    assert said == [(TOPIC, 0, 1, 2), (TOPIC, 0, 5, 6), (TOPIC, 0, 8, 9), (TOPIC, 1, 1, 1)]
    recorder.close()


def test_what_was_asked_for_is_taken_where_it_is_missing_and_only_there(tmp_path: Path, kit: Any) -> None:
    recorder = BagRecorder(BagWriter(tmp_path / "run"), kit.TOPICS)
    for sequence in (1, 2, 5):
        recorder(0, mode(kit, sequence))
    for sequence in (2, 3, 4, 4, 5):
        recorder.fill(1, mode(kit, sequence))
    assert recorder.taken == 5
    topic = recorder.close().topics[TOPIC]
    assert (topic.count, topic.lost, topic.repeated) == (5, 0, 0)


def test_a_topic_can_be_told_where_it_begins(tmp_path: Path, kit: Any) -> None:
    recorder = BagRecorder(BagWriter(tmp_path / "run"), kit.TOPICS, from_start=False)
    recorder.expect_from(TOPIC, 0, 5)
    recorder(0, mode(kit, 7))
    topic = recorder.close().topics[TOPIC]
    assert [(gap.first, gap.last) for gap in topic.gaps] == [(5, 6)]


def test_a_publisher_that_moves_says_how_far_it_came(tmp_path: Path, kit: Any) -> None:
    recorder = BagRecorder(BagWriter(tmp_path / "run"), kit.TOPICS)
    recorder(0, mode(kit, 1))
    recorder(0, pack(TOPIC.encode(), Kind.MOVED, 0, 3, 10, 0, b"there"))
    assert recorder.close().topics[TOPIC].lost == 2


@settings(deadline=None, max_examples=50)
@given(st.permutations(range(1, 12)), st.integers(0, 11))
def test_an_account_lacks_exactly_what_is_in_its_gaps(order: list[int], seen: int) -> None:
    account = EpochAccount(0, 1)
    for sequence in order[:seen]:
        account.add(sequence)
    last = max(order[:seen], default=0)
    missing = {n for gap in account.gaps for n in range(gap.first, gap.last + 1)}
    assert missing == set(range(1, last + 1)) - set(order[:seen])
    assert all(account.lacks(n) == (n in missing) for n in range(13))
