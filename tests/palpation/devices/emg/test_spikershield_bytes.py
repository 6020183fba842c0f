"""A serial line cuts its bytes anywhere: what the SpikerShield said does not depend on where."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.palpation.devices.wire.spikershield import Decoder

BEGIN, END = b"\xff\xff\x01\x01\x80\xff", b"\xff\xff\x01\x01\x81\xff"
FRAME = bytes.fromhex("84000403")


def frames(values: list[tuple[int, int]]) -> bytes:
    return b"".join(bytes([0x80 | a >> 7, a & 0x7F, b >> 7, b & 0x7F]) for a, b in values)


pairs = st.lists(st.tuples(st.integers(0, 1023), st.integers(0, 1023)), max_size=8)


@settings(max_examples=150, deadline=None)
@given(before=pairs, after=pairs, cuts=st.lists(st.integers(1, 7), min_size=1, max_size=8))
def test_a_message_between_frames_is_no_sample_wherever_the_reads_end(
    before: list[tuple[int, int]], after: list[tuple[int, int]], cuts: list[int]
) -> None:
    data = frames(before) + BEGIN + b"EVNT:1;" + END + frames(after)
    decoder, found, at = Decoder(2), list[list[float]](), 0
    while at < len(data):
        size = cuts[at % len(cuts)]
        values, dropped = decoder.feed(data[at : at + size])
        assert not dropped
        found += values.tolist()
        at += size
    assert found == [[float(a), float(b)] for a, b in before + after]


def test_a_message_that_never_ends_does_not_swallow_what_follows() -> None:
    decoder, count, losses = Decoder(2), 0, 0
    for data in (BEGIN, *[FRAME * 10] * 100):
        values, dropped = decoder.feed(data)
        count += len(values)
        losses += dropped
    assert count == 1000
    assert (losses, decoder.dropped_count) == (1, len(BEGIN))
