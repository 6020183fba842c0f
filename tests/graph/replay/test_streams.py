"""Recorded messages come back by their sequences, whenever they were recorded, in flat memory."""

from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.graph.bag.reader import Bag
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.topic import Topic
from palp_core.graph.replay.streams import LATE_NS, OrderedMessages, RecordedInputs, key_of

TOPIC = Topic(name="/a/b")


def bag_of(folder: Path, messages: list[tuple[int, int, int]]) -> Path:
    """Write messages of (epoch, sequence, log time)."""
    with BagWriter(folder) as writer:
        for epoch, sequence, log_ns in messages:
            writer.write(writer.stream(Stream(topic=TOPIC, epoch=epoch)), sequence, log_ns, log_ns, b"\x80")
    return folder


@settings(max_examples=25)
@given(st.permutations(range(1, 9)), st.permutations(range(1, 5)))
def test_late_messages_stand_where_they_belong(
    tmp_path_factory: object, first: list[int], second: list[int]
) -> None:
    folder = tmp_path_factory.mktemp("bag") / "run"  # type: ignore[attr-defined]
    found = [(0, n) for n in first] + [(1, n) for n in second]
    bag_of(folder, [(epoch, n, place) for place, (epoch, n) in enumerate(found)])
    with Bag(folder) as bag:
        assert [key_of(m) for m in OrderedMessages(bag, "/a/b")] == sorted(found)


def test_a_repeated_message_comes_once_and_a_gap_holds_nothing_up_for_long(tmp_path: Path) -> None:
    late = 2 * LATE_NS
    found = [(0, 1, 0), (0, 2, 1), (0, 2, 2), (0, 4, 3), (0, 5, 4), (0, 6, late), (0, 3, late + 1)]
    bag_of(tmp_path / "run", found)
    with Bag(tmp_path / "run") as bag:
        assert [m.sequence for m in OrderedMessages(bag, "/a/b")] == [1, 2, 4, 5, 6]


def test_an_input_is_found_wherever_it_is_near(tmp_path: Path) -> None:
    bag_of(tmp_path / "run", [(0, n, n) for n in (1, 2, 3, 5, 6)])
    with Bag(tmp_path / "run") as bag:
        inputs = RecordedInputs(bag)
        for sequence in (2, 1, 6, 3):  # replies may come in another order than requests were made
            found = inputs.find("/a/b", 0, sequence)
            assert found is not None
            assert found.sequence == sequence
        assert inputs.find("/a/b", 0, 4) is None
        assert inputs.find("/a/b", 1, 1) is None
