"""Frames: what comes out is what went in, and garbage is refused in one way only and harms no node."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
import zmq
from hypothesis import example, given
from hypothesis import strategies as st

from palp_core import Message, Node, Sub, on
from palp_core.errors import SchemaMismatch
from palp_core.graph.clock import SimClock
from palp_core.graph.messages.frame import (
    HEADER_BYTES,
    LAST_SEQUENCE,
    VERSION,
    Kind,
    pack,
    parse,
    raw_of,
    sequence_of,
    topic_of,
)
from palp_core.graph.messages.message import encode
from palp_core.graph.messages.schema import schema_of
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.lifecycle import Lifecycle, Transition
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.transport.receiver import TopicReceiver
from palp_core.units import Float64Array, Metres

topics = st.from_regex(r"/[a-z_]{1,12}/[a-z_]{1,12}", fullmatch=True)
u64 = st.integers(0, 2**64 - 1)
frames = st.builds(
    pack,
    topics.map(str.encode),
    st.sampled_from(Kind),
    st.integers(0, 2**32 - 1),
    st.integers(1, LAST_SEQUENCE),
    st.integers(-(2**63), 2**63 - 1),
    u64,
    st.binary(max_size=40),
)


@given(
    topics,
    st.sampled_from(Kind),
    st.integers(0, 2**32 - 1),
    st.integers(1, LAST_SEQUENCE),
    st.integers(-(2**63), 2**63 - 1),
    u64,
    st.binary(max_size=40),
)
def test_a_parsed_frame_is_what_was_packed(
    topic: str, kind: Kind, epoch: int, sequence: int, stamp_ns: int, type_hash: int, payload: bytes
) -> None:
    data = pack(topic.encode(), kind, epoch, sequence, stamp_ns, type_hash, payload)
    assert tuple(parse(data)) == (topic, kind, epoch, sequence, stamp_ns, type_hash, payload)
    assert topic_of(data) == topic.encode()
    assert sequence_of(data, len(topic)) == sequence
    assert len(data) == len(topic) + 1 + HEADER_BYTES + len(payload)


def test_the_header_is_32_little_endian_bytes_after_topic_and_nul() -> None:
    data = pack(b"/a/b", Kind.DATA, 2, 3, 4, 5, b"payload")
    header = bytes([2, 0, 0, 0, 2, 0, 0, 0, 3, *[0] * 7, 4, *[0] * 7, 5, *[0] * 7])
    assert data == b"/a/b\0" + header + b"payload"


def fits(raw: bytes) -> bool:
    """Tell whether bytes are a frame of one message, by what the wire's description says."""
    topic, nul, rest = raw.partition(b"\0")
    if not nul or not 1 <= len(topic) <= 255 or len(rest) < HEADER_BYTES:
        return False
    version, kind, sequence = rest[0], rest[1], int.from_bytes(rest[8:16], "little")
    first = 1 if kind == Kind.DATA else 0
    is_text = topic.decode(errors="replace").encode() == topic
    return version == 2 and kind in list(Kind) and first <= sequence <= LAST_SEQUENCE and is_text


@given(st.binary(max_size=80) | frames, st.data())
def test_damaged_bytes_are_refused_at_the_header_or_all_of_them_are_parsed(
    sent: bytes, data: st.DataObject
) -> None:
    damaged = bytearray(sent)
    place = data.draw(st.integers(0, len(sent)))
    damaged[place : place + 1] = data.draw(st.binary(max_size=1))
    if not fits(bytes(damaged)):
        with pytest.raises(SchemaMismatch):
            parse(bytes(damaged))
        return
    frame = parse(bytes(damaged))
    header = damaged.find(0) + 1
    damaged[header + 2 : header + 4] = bytes(2)  # flags are ignored
    assert raw_of(frame) == damaged


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda f: b"", "no topic"),
        (lambda f: f[4:], "no topic"),
        (lambda f: b"x" * 252 + f, "no topic"),
        (lambda f: f[:5] + b"\x03" + f[6:], "version 3"),
        (lambda f: f[:5] + b"\x01" + f[6:], "version 1"),
        (lambda f: f[:6] + b"\x04" + f[7:], "kind 4"),
        (lambda f: b"/\xff/b" + f[4:], "UTF-8"),
        (lambda f: f[:-1], "too few"),
        (lambda f: f[:13] + bytes(8) + f[21:], "without a sequence"),
        (lambda f: f[:13] + (LAST_SEQUENCE + 1).to_bytes(8, "little") + f[21:], "so many messages"),
    ],
)
def test_the_refusal_says_what_is_wrong(damage, words) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(SchemaMismatch, match=words):
        parse(damage(pack(b"/a/b", Kind.DATA, 0, 1, 0, 0)))


def test_the_longest_topic_and_the_last_sequence_are_parsed() -> None:
    topic = "/" + "x" * 254
    assert parse(pack(topic.encode(), Kind.DATA, 0, LAST_SEQUENCE, 0, 0))[:4] == (topic, 0, 0, LAST_SEQUENCE)


class Inner(Message):
    depth_m: Metres


class Word(Message):
    n: int
    text: str
    values: Float64Array
    inner: Inner


class Reader(Node):
    word = Sub(Word)

    @on(word)
    def take(self, word: Word) -> None:
        assert type(word.n) is int
        assert type(word.text) is str
        assert word.values.ndim == 1
        assert 0.0 <= word.inner.depth_m < 1e9


class Target:
    """A reader's receiver, which the test feeds by hand."""

    def __init__(self, folder: Path) -> None:
        self.context: zmq.Context[Any] = zmq.Context()
        spec = NodeSpec(name="r", run="m:R", inputs={"word": "/p/word"})
        self.clock = SimClock()
        self.executor = Executor(Reader, spec, self.clock, lambda _: None)
        publishers = {"/p/word": (f"ipc://{folder}/p", f"ipc://{folder}/s")}
        self.receiver = TopicReceiver(self.executor, publishers, self.context, None)
        self.executor.transition(Transition.CONFIGURE)
        self.executor.transition(Transition.ACTIVATE)
        self.receiver.set_start(0)

    def feed(self, raw: bytes) -> None:
        self.receiver._arrive(raw, 1)
        while self.executor.inbox:
            self.receiver.deliver_next()

    def close(self) -> None:
        self.receiver.close()
        self.context.destroy(linger=0)


@pytest.fixture
def target(tmp_path: Path) -> Iterator[Target]:
    made = Target(tmp_path)
    yield made
    made.close()


GOOD = encode(Word(n=1, text="x", values=np.array([0.5]), inner=Inner(depth_m=0.1)))
HASH = schema_of(Word).type_hash
scalars = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.binary() | st.text()
trees = st.recursive(
    scalars,
    lambda inner: st.lists(inner) | st.dictionaries(st.text() | st.integers(0, 9), inner),
    max_leaves=20,
)


def packed(tree: Any) -> bytes:
    return bytes(msgpack.packb(tree, unicode_errors="surrogatepass"))


nested = st.integers(1, 3000).map(lambda depth: b"\x91" * depth + b"\xc0")
payloads = st.one_of(
    st.binary(max_size=200),
    trees.map(packed),
    nested,
    st.just(GOOD),
    st.tuples(st.integers(0, len(GOOD)), st.binary(max_size=8)).map(lambda cut: GOOD[: cut[0]] + cut[1]),
    st.just(b"\xc6\xff\xff\xff\xff" + b"\0" * 64),  # claims to hold 4 GiB
    st.just(b"\xdf\xff\xff\xff\xff"),
)


@st.composite
def hostile_frames(draw: st.DrawFn) -> bytes:
    """Whole frames with wrong parts, parts of frames, and bytes that are none."""
    shape = draw(st.sampled_from(["random", "header", "truncated", "whole"]))
    if shape == "random":
        return draw(st.binary(max_size=300))
    topic = draw(st.sampled_from([b"/p/word", b"/p/wor", b"", b"\xff\xfe", b"/" * 400, b"/q/other"]))
    kind, version = draw(st.integers(0, 255)), draw(st.sampled_from([VERSION] * 3 + [0, 1, 255]))
    numbers = struct.pack(
        "<BBHIQqQ",
        version,
        draw(st.sampled_from([Kind.DATA, Kind.DATA, Kind.HEARTBEAT, Kind.MOVED, Kind.IDLE, kind])),
        draw(st.sampled_from([0, 0, 1, 65535])),
        draw(st.sampled_from([0, 0, 1, 2**32 - 1])),
        draw(st.one_of(st.integers(0, 50), st.just(2**64 - 1))),
        draw(st.integers(-(2**63), 2**63 - 1)),
        draw(st.sampled_from([HASH, HASH, 0, 2**64 - 1])),
    )
    assert len(numbers) == HEADER_BYTES
    whole = topic + b"\0" + numbers + draw(payloads)
    length: int = draw(st.integers(0, len(whole))) if shape == "truncated" else len(whole)
    cut: bytes = whole[:length]
    return cut


@given(raw=hostile_frames())
@example(raw=pack(b"/p/word", Kind.DATA, 0, 1, 0, HASH))
def test_a_malformed_frame_harms_nothing(target: Target, raw: bytes) -> None:
    account = target.executor.ends.accounts["/p/word"]
    before = target.executor.events.rejected_count + account.received
    target.feed(raw)
    assert target.executor.lifecycle is Lifecycle.ACTIVE
    after = target.executor.events.rejected_count + account.received
    assert after >= before  # one that fills a gap sets free what was held behind it
