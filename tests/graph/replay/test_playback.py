"""When what is due, on a clock that the test sets."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.errors import BagError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.messages.frame import parse
from palp_core.graph.replay.play import FASTEST, Playback

TOPIC = "/torque/block"
START_NS = 5_000_000_000
PERIOD_NS = 1_000_000
OPEN: list[Playback] = []
"""To be closed after the test."""


@pytest.fixture
def bag(tmp_path: Path, kit: Any) -> Iterator[Bag]:
    """Messages 1 to 100, 1 ms apart from 0 s, and two of a latched topic."""
    folder, _ = kit.record(tmp_path / "run", kit.run_frames(100), chunk_bytes=2048)
    with Bag(folder) as opened:
        yield opened
    while OPEN:
        OPEN.pop().__exit__()


class Played:
    """What is played of a bag: places in the recording, and when."""

    def __init__(self, bag: Bag, **options: Any) -> None:
        place_of = {m.payload: place for place, m in enumerate(bag.recorded([TOPIC]))}
        self.found: list[tuple[int, int]] = []
        self.now_ns = START_NS
        self.playback = Playback(bag, {TOPIC: TOPIC}, **options)
        OPEN.append(self.playback)

        def send(raw: bytes) -> None:
            frame = parse(raw)
            if frame.topic == TOPIC and frame.payload:
                self.found.append((place_of[bytes(frame.payload)], self.now_ns))

        self.playback.send = send
        self.playback.start(START_NS)

    def until(self, end_ns: int = 1 << 62, count: int = 1000) -> list[tuple[int, int]]:
        """Play everything exactly when it is due; return what came."""
        before = len(self.found)
        while (due_ns := self.playback.due_ns()) is not None and due_ns <= end_ns:
            self.now_ns = due_ns
            self.playback.play_due(due_ns)
            if len(self.found) >= count:
                break
        return self.found[before:]


def at(*milliseconds: float) -> list[int]:
    return [START_NS + round(ms * PERIOD_NS) for ms in milliseconds]


@pytest.mark.parametrize(
    ("options", "places", "first_ms", "spacing_ms"),
    [
        ({}, range(100), 0.0, 1.0),
        ({"rate": 2.0}, range(100), 0.0, 0.5),
        ({"start_offset_s": 0.0105}, range(11, 100), 0.5, 1.0),
        ({"start_offset_s": 0.0105, "duration_s": 0.01}, range(11, 21), 0.5, 1.0),
        ({"until_s": 0.0}, range(1), 0.0, 1.0),
        ({"duration_s": 0.02, "until_s": 0.01}, range(11), 0.0, 1.0),
    ],
)
def test_messages_keep_order_and_spacing_between_beginning_and_end(
    bag: Bag, options: dict[str, float], places: range, first_ms: float, spacing_ms: float
) -> None:
    played = Played(bag, **options)
    played.until()
    due_ns = at(*(first_ms + spacing_ms * number for number in range(len(places))))
    assert played.found == list(zip(places, due_ns, strict=True))
    assert played.playback.finished
    assert played.playback.played_count == len(places)
    assert played.playback.lateness.max_ns == 0


def test_nothing_to_play_is_an_error_that_says_what_there_is(bag: Bag) -> None:
    with pytest.raises(BagError, match=r"no message of the chosen topics and time; the bag has 0\.000"):
        Played(bag, start_offset_s=3600.0)
    with pytest.raises(BagError, match="no message"):
        Playback(bag, {"/no/where": "/no/where"})


def test_nothing_is_due_in_a_pause_and_the_spacing_goes_on_after_it(bag: Bag) -> None:
    played = Played(bag)
    last_ns = played.until(START_NS + 10 * PERIOD_NS)[-1][1]
    pause_ns = last_ns + PERIOD_NS // 4
    played.playback.toggle(pause_ns)
    assert played.playback.due_ns() is None
    assert played.playback.position_ns(pause_ns + 10**9) == pause_ns - START_NS
    played.playback.toggle(pause_ns + 10**9)
    assert played.playback.due_ns() == pause_ns + 10**9 + 3 * PERIOD_NS // 4


def test_a_new_rate_holds_from_now_on(bag: Bag) -> None:
    played = Played(bag)
    last_ns = played.until(START_NS + 10 * PERIOD_NS)[-1][1]
    played.playback.set_rate(0.5, last_ns)
    assert played.playback.due_ns() == last_ns + 2 * PERIOD_NS
    played.playback.set_rate(1e9, last_ns)
    assert played.playback.rate == FASTEST


def test_a_loop_begins_again_without_end(bag: Bag) -> None:
    played = Played(bag, loop=True)
    played.until(count=250)
    assert [place for place, _ in played.found] == [*range(100), *range(100), *range(50)]
    assert not played.playback.finished


def test_a_late_player_says_so_and_catches_up_in_order(bag: Bag) -> None:
    played = Played(bag)
    late_ns = START_NS + 30 * PERIOD_NS
    played.now_ns = late_ns
    played.playback.play_due(late_ns)
    assert [place for place, _ in played.found] == list(range(31))
    late = played.playback.lateness
    assert late.max_ns == 29 * PERIOD_NS  # the first came with the start
    assert late.percentile_s(50) == pytest.approx(15 * PERIOD_NS / 1e9, rel=0.0626)  # as wide as its classes
    assert played.until()[0] == (31, late_ns + PERIOD_NS)


@settings(max_examples=30)
@given(
    deeds=st.lists(st.tuples(st.sampled_from(["play", "toggle", "rate"]), st.integers(0, 40)), max_size=30)
)
def test_whatever_is_pressed_messages_come_in_order_and_never_early(
    bag: Bag, deeds: list[tuple[str, int]]
) -> None:
    played = Played(bag)
    playback = played.playback
    for deed, number in deeds:
        played.now_ns += number * PERIOD_NS // 3
        if deed == "play":
            playback.play_due(played.now_ns)
        elif deed == "toggle":
            playback.toggle(played.now_ns)
        else:
            playback.set_rate(0.25 * (number + 1), played.now_ns)
        count = len(played.found)
        assert [place for place, _ in played.found] == list(range(count))
        assert (
            count == 100
            or (count - 1) * PERIOD_NS <= playback.position_ns(played.now_ns) <= count * PERIOD_NS
        )
    assert playback.lateness.percentile_s(0) >= 0.0
