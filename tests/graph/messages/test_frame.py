"""Frames: what comes out is what went in, and garbage is refused in one way only."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palp_core.errors import SchemaMismatch
from palp_core.graph.messages.frame import (
    HEADER_BYTES,
    LAST_SEQUENCE,
    Kind,
    pack,
    parse,
    raw_of,
    sequence_of,
    topic_of,
)

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
