"""Large messages in pieces: the same message, with its array copied as rarely as can be."""

from __future__ import annotations

import itertools
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core import Message
from palp_core.errors import SchemaMismatch
from palp_core.graph.messages.fragments import CUT_FROM, Pieces, cut, decode_pieces, give_away
from palp_core.graph.messages.message import decode, encode
from palp_core.units import Float64Array, RatioArray

LARGE = CUT_FROM // 8


class Picture(Message):
    name: str = "x"
    small: Float64Array = np.zeros(0)
    pixels: Float64Array = np.zeros(0)
    other: RatioArray = np.zeros(0)
    n: int = 3


def joined(pieces: Pieces) -> bytes:
    return b"".join(pieces)


def from_pieces(pieces: Pieces, *cuts: int) -> Any:
    payload = joined(pieces)
    own = itertools.accumulate(map(len, pieces[:2]))
    views = [memoryview(payload[a:b]) for a, b in itertools.pairwise((0, *(cuts or own), len(payload)))]
    return decode_pieces(Picture, views[0], views[1:])


def test_small_messages_are_not_cut() -> None:
    assert cut(Picture(pixels=np.zeros(LARGE - 1))) is None


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 40), st.integers(LARGE, LARGE + 9), st.text(max_size=40), st.booleans())
def test_the_pieces_joined_are_the_message(small: int, large: int, name: str, writeable: bool) -> None:
    pixels = np.random.default_rng(large).normal(size=large)
    pixels.flags.writeable = writeable
    message = Picture(name=name, small=np.ones(small), pixels=pixels)
    pieces = cut(message)
    assert pieces is not None
    assert joined(pieces) == encode(message)
    assert from_pieces(pieces) == message


def test_the_larger_of_two_arrays_is_the_one_cut_out() -> None:
    message = Picture(pixels=np.ones(LARGE), other=np.full(2 * LARGE, 0.5))
    pieces = cut(message)
    assert pieces is not None
    assert len(pieces.body) == 16 * LARGE
    assert from_pieces(pieces) == message


def test_a_read_only_array_is_not_copied_and_another_one_is() -> None:
    pixels = np.ones(LARGE)
    copied = cut(Picture(pixels=pixels))
    pixels.flags.writeable = False
    shared = cut(Picture(pixels=pixels))
    assert copied is not None
    assert shared is not None
    assert np.shares_memory(np.frombuffer(shared.body), pixels)
    assert not np.shares_memory(np.frombuffer(copied.body), pixels)


def test_what_is_received_is_a_view_that_cannot_be_written_to() -> None:
    pieces = cut(Picture(pixels=np.ones(LARGE)))
    assert pieces is not None
    body = memoryview(bytes(pieces.body))
    message = decode_pieces(Picture, memoryview(pieces.head), [body, memoryview(pieces.tail)])
    assert np.shares_memory(message.pixels, np.frombuffer(body))
    assert not message.pixels.flags.writeable


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 8 * LARGE), st.integers(0, 100))
def test_pieces_cut_anywhere_else_are_joined_again(first: int, more: int) -> None:
    message = Picture(pixels=np.ones(LARGE), name="somebody else's")
    pieces = cut(message)
    assert pieces is not None
    assert from_pieces(pieces, first, first + more) == message


def test_a_text_that_looks_like_the_stand_in_is_sent_whole() -> None:
    name = str(b"\xc4\x10palp: cut here!!", "latin-1")
    assert cut(Picture(name=name, pixels=np.ones(LARGE))) is not None  # latin-1 is not what travels
    twice = msgspec.structs.replace(Picture(pixels=np.ones(LARGE)), small=np.frombuffer(b"palp: cut here!!"))
    assert cut(twice) is None


def test_bounds_hold_for_an_array_in_pieces_too() -> None:
    values = np.full(LARGE, 0.5)
    pieces = cut(Picture(other=values))
    assert pieces is not None
    values[7] = np.nan
    bad = Pieces(pieces.head, memoryview(values.tobytes()), pieces.tail)
    with pytest.raises(SchemaMismatch, match="other"):
        from_pieces(bad)
    with pytest.raises(SchemaMismatch, match="other"):
        decode(Picture, joined(bad))


def test_an_array_that_is_given_away_travels_as_it_is_and_can_be_written_to_no_more() -> None:
    pixels, small = np.ones(LARGE), np.ones(3)
    message = Picture(pixels=pixels, small=small)
    give_away(message)
    pieces = cut(message)
    assert pieces is not None
    assert np.shares_memory(np.frombuffer(pieces.body), pixels)
    for array in (pixels, small):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 2.0
    assert from_pieces(pieces) == Picture(pixels=np.ones(LARGE), small=np.ones(3))


def test_a_view_of_anothers_memory_is_copied_though_given_away() -> None:
    camera = np.ones(2 * LARGE)
    message = Picture(pixels=camera[:LARGE])
    give_away(message)
    pieces = cut(message)
    assert pieces is not None
    camera[0] = 2.0
    assert from_pieces(pieces) == Picture(pixels=np.ones(LARGE))
