"""A tool's listener: in order, each once, gaps filled from the publisher's history or counted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.discovery.topic_reader import ReceivedFrame, TopicReader
from palp_core.graph.messages.frame import Kind, pack
from tests.cli.test_remote import record

TOPIC = "/relay/amplified"


def frame(sequence: int, kind: Kind = Kind.DATA, epoch: int = 0) -> bytes:
    return pack(TOPIC.encode(), kind, epoch, sequence, sequence * 10, 1)


class History:
    """A publisher that keeps the last few messages of epoch 0 or 1 and answers a few at a time."""

    def __init__(self, last: int, depth: int, epoch: int = 0, at_once: int = 3) -> None:
        self.last, self.depth, self.epoch, self.at_once = last, depth, epoch, at_once
        self.asked: list[tuple[int, int]] = []
        self._replies: list[dict[str, Any]] = []

    def ask_history(self, endpoint: str, topic: str, first: int, last: int) -> None:
        self.asked.append((first, last))
        kept = range(max(first, self.last - self.depth + 1), min(last, self.last) + 1)[: self.at_once]
        frames = [frame(n, epoch=self.epoch) for n in kept]
        self._replies.append({"topic": topic, "frames": frames, "epoch": self.epoch})

    def replies(self) -> list[dict[str, Any]]:
        replies, self._replies = self._replies, []
        return replies

    def close(self) -> None:
        """Nothing is open."""


def follow(
    tmp_path: Path, history: History, frames: list[bytes], **options: Any
) -> tuple[list[tuple[int, int]], int]:
    """Return epoch and sequence of what is handed over, and how many were said to be lost."""
    graph = RunningGraph(record(tmp_path))
    with TopicReader(graph, [graph.topic(TOPIC)], **options) as listener:
        listener._requester.close()
        listener._requester = history  # type: ignore[assignment]
        for raw in frames:
            listener._reader._arrive(raw, 0)
            while history._replies:
                listener._take_answers()
        heard: list[ReceivedFrame] = listener._received
    messages = [(h.frame.epoch, h.frame.sequence) for h in heard if h.is_message]
    return messages, sum(h.lost for h in heard)


PLAIN: dict[str, Any] = {}
RELIABLE: dict[str, Any] = {"reliable": True}
BEAT = Kind.HEARTBEAT
RESTARTED = [frame(10), frame(3, BEAT, epoch=1), frame(4, epoch=1), frame(11)]


@pytest.mark.parametrize(
    ("history", "frames", "options", "expected", "lost"),
    [
        (History(9, 9), [frame(4, BEAT), frame(5), frame(8), frame(9, BEAT)], PLAIN, [5, 8], 3),
        (History(20, 20), [frame(5), frame(12), frame(14, BEAT), frame(15)], RELIABLE, range(5, 16), 0),
        (History(100, 10), [frame(100, BEAT), frame(101)], {"history_depth": 5}, range(96, 102), 0),
        (History(30, 4), [frame(10), frame(31)], RELIABLE, [10, 27, 28, 29, 30, 31], 16),
        (History(4, 9, epoch=1), RESTARTED, RELIABLE, [10, 1, 2, 3, 4], 0),
        (History(0, 0), [frame(5, Kind.MOVED)], PLAIN, [], 0),
    ],
    ids=["plain", "fills gaps", "joins late", "history is short", "publisher restarted", "another kind"],
)
def test_what_is_handed_over_and_what_is_counted_as_lost(
    tmp_path: Path, history: History, frames: list[bytes], options: Any, expected: Any, lost: int
) -> None:
    messages, missing = follow(tmp_path, history, frames, **options)
    assert [sequence for _, sequence in messages] == list(expected)
    assert missing == lost
    assert bool(history.asked) == bool(options)


@settings(max_examples=60)
@given(
    arriving=st.lists(st.integers(1, 40), max_size=30),
    depth=st.integers(0, 40),
    reliable=st.booleans(),
    history_depth=st.integers(0, 20),
)
def test_whatever_arrives_everything_is_in_order_once_and_accounted_for(
    tmp_path: Path, arriving: list[int], depth: int, reliable: bool, history_depth: int
) -> None:
    frames = [frame(n) for n in arriving]
    options = {"reliable": reliable, "history_depth": history_depth}
    messages, lost = follow(tmp_path, History(40, depth), frames, **options)
    sequences = [sequence for _, sequence in messages]
    assert sequences == sorted(set(sequences))
    if sequences:
        assert len(sequences) + lost == sequences[-1] - sequences[0] + 1


def test_what_waits_for_a_gap_is_handed_over_when_the_graph_has_ended(tmp_path: Path) -> None:
    graph = RunningGraph(record(tmp_path))  # whose folder is not locked
    taken: list[ReceivedFrame] = []
    with TopicReader(graph, [graph.topic(TOPIC)], reliable=True) as listener:
        for sequence in (1, 4, 7):
            listener._reader._arrive(frame(sequence), 0)
        listener.turn(taken.append)
    assert [(one.frame.sequence, one.lost) for one in taken] == [(1, 0), (3, 2), (4, 0), (6, 2), (7, 0)]
