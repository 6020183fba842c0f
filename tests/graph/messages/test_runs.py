"""Several messages in one frame are the same messages as each in its own; what is none stays what it is."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core import Message, Qos
from palp_core.errors import LifecycleError, SchemaMismatch
from palp_core.graph.messages.frame import Kind, pack, parse
from palp_core.graph.messages.message import run_decoder_of
from palp_core.graph.messages.runs import RUN_BYTES, RUN_MESSAGES, singles
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.publisher import History, PublisherEnd
from palp_core.units import MetresNonNegative, NewtonMetresArray


class Sample(Message):
    depth_m: MetresNonNegative
    torque_n_m: NewtonMetresArray
    text: str = ""


class Owner:
    """A node that may publish, at one time of its clock."""

    publishing = True
    send_pieces = None

    def now_ns(self) -> int:
        return 7

    def resend(self, frame: bytes) -> None:
        raise NotImplementedError


def published(messages: list[Sample], depth: int, *, runs: bool) -> tuple[list[bytes], list[bytes]]:
    """Return the frames that are sent, and those that are remembered."""
    frames = list[bytes]()
    end = PublisherEnd("/p/sample", Sample, Qos(depth=depth), 3, Owner(), frames.append)
    if runs:
        end.send_run = frames.append
    end.publish_all(messages)
    return frames, end.history.frames()


samples = st.builds(
    Sample,
    depth_m=st.one_of(st.floats(0.0, 1.0), st.integers(0, 1)),
    torque_n_m=st.lists(st.floats(-1.0, 1.0), max_size=40).map(np.array),
    text=st.text(max_size=5),
)


@settings(deadline=None, max_examples=100)
@given(st.lists(samples, max_size=3 * RUN_MESSAGES), st.integers(1, 100))
def test_a_run_is_the_frames_that_its_messages_would_have_had(messages: list[Sample], depth: int) -> None:
    sent, remembered = published(messages, depth, runs=True)
    each, remembered_of_each = published(messages, depth, runs=False)
    assert [one for frame in sent for one in singles(frame)] == each
    assert remembered == remembered_of_each
    assert len(sent) == -(-len(messages) // RUN_MESSAGES)
    decode = run_decoder_of(Sample)
    for frame in sent:
        if (found := singles(frame)) != [frame]:
            assert decode(memoryview(frame)[len("/p/sample") + 33 :]) == [
                run_decoder_of(Sample)(b"\x91" + bytes(parse(one).payload))[0] for one in found
            ]


def test_messages_that_are_too_large_together_travel_each_in_its_own_frame() -> None:
    large = Sample(depth_m=0.0, torque_n_m=np.zeros(RUN_BYTES // 16))
    sent, _ = published([large, large, large], 10, runs=True)
    assert [parse(frame).sequence for frame in sent] == [1, 2, 3]


def test_of_a_message_of_another_type_those_before_it_are_sent_and_it_is_named() -> None:
    class Other(Message):
        n: int

    frames = list[bytes]()
    end = PublisherEnd("/p/sample", Sample, Qos(), 0, Owner(), frames.append)
    end.send_run = frames.append
    good = Sample(depth_m=0.0, torque_n_m=np.zeros(1))
    with pytest.raises(TypeError, match="/p/sample carries Sample, not Other"):
        end.publish_all([good, good, Other(n=1)])  # type: ignore[list-item]
    assert [parse(one).sequence for frame in frames for one in singles(frame)] == [1, 2]


class Sent:
    """An end with what it has sent."""

    def __init__(self) -> None:
        self.frames = list[bytes]()
        self.end = PublisherEnd("/p/sample", Sample, Qos(), 0, Owner(), self.frames.append)
        self.end.send_run = self.frames.append

    @property
    def sequences(self) -> list[int]:
        return [parse(one).sequence for frame in self.frames for one in singles(frame)]


def sample(value: float = 0.0) -> Sample:
    return Sample(depth_m=0.0, torque_n_m=np.array([value]))


def test_of_a_message_that_cannot_travel_those_before_it_are_sent_and_none_is_missed() -> None:
    sent = Sent()
    flat = Sample(depth_m=0.0, torque_n_m=np.zeros((2, 2)))
    with pytest.raises(SchemaMismatch, match=r"an array of shape \(2, 2\) cannot travel"):
        sent.end.publish_all([sample(), sample(), flat, sample()])
    assert sent.sequences == [1, 2]
    sent.end.publish_all([sample(), sample()])
    assert sent.sequences == [1, 2, 3, 4]


def test_of_a_generator_that_fails_the_messages_before_are_sent() -> None:
    def made() -> Iterator[Sample]:
        yield sample()
        yield sample()
        raise OSError("the driver is gone")

    sent = Sent()
    with pytest.raises(OSError, match="driver"):
        sent.end.publish_all(made())
    assert sent.sequences == [1, 2]


def test_a_message_goes_as_it_was_when_the_next_was_made_of_the_same_array() -> None:
    buffer = np.zeros(1)

    def made() -> Iterator[Sample]:
        for n in range(1, 4):
            buffer[0] = n
            yield Sample(depth_m=0.0, torque_n_m=buffer)

    sent = Sent()
    sent.end.publish_all(made())
    (frame,) = sent.frames
    found = run_decoder_of(Sample)(memoryview(frame)[len("/p/sample") + 33 :])
    assert [one.torque_n_m[0] for one in found] == [1.0, 2.0, 3.0]


def test_of_a_long_generator_no_more_is_held_than_a_run() -> None:
    sent, held = Sent(), list[int]()

    def made() -> Iterator[Sample]:
        for n in range(3 * RUN_MESSAGES):
            held.append(n - len(sent.sequences))
            yield sample()

    sent.end.publish_all(made())
    assert sent.sequences == list(range(1, 3 * RUN_MESSAGES + 1))
    assert max(held) <= RUN_MESSAGES


def test_a_large_message_among_small_ones_keeps_its_place() -> None:
    sent = Sent()
    large = Sample(depth_m=0.0, torque_n_m=np.zeros(RUN_BYTES // 8))
    sent.end.publish_all([sample(), sample(), large, sample(), sample()])
    assert [len(singles(frame)) for frame in sent.frames] == [2, 1, 2]
    assert sent.sequences == [1, 2, 3, 4, 5]


def test_as_many_messages_of_a_run_are_remembered_as_a_reader_may_be_behind() -> None:
    sent = Sent()
    sent.end.history = History(maxlen=500)  # as for a reader with which history: keep_all holds
    sent.end.publish_all([sample() for _ in range(30)])
    assert [parse(frame).sequence for frame in sent.end.history.frames()] == list(range(1, 31))


def test_a_node_that_may_not_publish_yet_publishes_no_run_either() -> None:
    owner, frames = Owner(), list[bytes]()
    owner.publishing = False
    end = PublisherEnd("/p/sample", Sample, Qos(), 0, owner, frames.append)
    end.send_run = frames.append
    good = Sample(depth_m=0.0, torque_n_m=np.zeros(1))
    with pytest.raises(LifecycleError, match="on_activate"):
        end.publish_all([good, good])
    assert frames == []


def test_messages_out_of_bounds_are_found_wherever_they_stand() -> None:
    bad = Sample(depth_m=0.0, torque_n_m=np.array([0.0, np.nan]))
    good = Sample(depth_m=0.0, torque_n_m=np.array([0.0, 1.0]))
    for run in ([bad, good, good], [good, bad, good], [good, good, bad]):
        (frame,), _ = published(run, 10, runs=True)
        with pytest.raises(SchemaMismatch, match="torque_n_m: an element is not within"):
            run_decoder_of(Sample)(memoryview(frame)[len("/p/sample") + 33 :])


HASH = schema_of(Sample).type_hash
ONE = msgspec.msgpack.encode({"depth_m": 0.0, "torque_n_m": b""})


@pytest.mark.parametrize(
    ("first", "payload"),
    [
        pytest.param(1, ONE, id="a map"),
        pytest.param(1, b"\x91" + ONE, id="one message"),
        pytest.param(1, b"\x93" + ONE + ONE, id="cut off"),
        pytest.param(1, b"", id="empty"),
        pytest.param(0, b"\x92" + ONE + ONE, id="sequence 0"),
        pytest.param(2**53, b"\x92" + ONE + ONE, id="sequences that no topic has"),
        pytest.param(1, b"\xdd\xff\xff\xff\xff" + ONE, id="four thousand million messages"),
        pytest.param(1, b"\x92" + ONE + b"\x91" * 100_000 + b"\xc0", id="a message of lists in lists"),
    ],
)
def test_what_is_no_run_is_left_as_it_is_and_refused(first: int, payload: bytes) -> None:
    frame = pack(b"/p/sample", Kind.RUN, 0, first, 0, HASH, payload)
    assert singles(frame) == [frame]
    with pytest.raises(SchemaMismatch, match="a run of messages that is none"):
        parse(frame)


def test_a_run_of_no_messages_decodes_to_none_which_is_no_error_of_the_reader() -> None:
    assert run_decoder_of(Sample)(b"\x90") == []


def test_flags_that_nobody_knows_are_passed_over_in_a_run_as_in_a_message() -> None:
    payload = b"\x92" + ONE + ONE
    frame = pack(b"/p/sample", Kind.RUN, 0, 1, 0, HASH, payload, flags=2)
    assert singles(frame) == singles(pack(b"/p/sample", Kind.RUN, 0, 1, 0, HASH, payload))


@settings(deadline=None, max_examples=300)
@given(st.binary(max_size=120), st.data())
def test_any_bytes_are_split_or_left_as_they_are(rubbish: bytes, data: st.DataObject) -> None:
    frame = bytearray(pack(b"/p/sample", Kind.RUN, 0, 1, 0, HASH, b"\x92" + ONE + ONE))
    frame[data.draw(st.integers(0, len(frame) - 1))] = data.draw(st.integers(0, 255))
    for raw in (rubbish, bytes(frame)):
        found = singles(raw)
        assert found == [raw] or all(one.startswith(raw[: raw.index(0) + 1]) for one in found)
