"""When what is due, on a clock that the test sets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palp_core.errors import BagError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.replay.playback import Playback

TOPIC = "/torque/block"
START_NS = 5_000_000_000
PERIOD_NS = 1_000_000


@pytest.fixture
def bag(tmp_path: Path, kit: Any) -> Any:
    """Messages 1 to 100, 1 ms apart from 0 s, and two of a latched topic."""
    folder, _ = kit.record(tmp_path / "run", kit.run_frames(100), chunk_bytes=2048)
    with Bag(folder) as opened:
        yield opened


def played(playback: Playback, until_ns: int = 1 << 62) -> list[tuple[int, int]]:
    """Take every message exactly when it is due; return its sequence and when that was."""
    found = []
    while (due_ns := playback.due_ns()) is not None and due_ns <= until_ns:
        found.append((playback.next_due(due_ns).sequence, due_ns))
    return found


def begun(bag: Bag, **options: Any) -> Playback:
    playback = Playback(bag, [TOPIC], **options)
    playback.start(START_NS)
    return playback


def test_messages_keep_their_order_and_spacing(bag: Bag) -> None:
    recorded = [(m.sequence, m.log_ns) for m in bag.recorded([TOPIC])]
    first_ns = min(m.log_ns for m in bag.recorded())
    playback = begun(bag)
    assert played(playback) == [(sequence, START_NS + log_ns - first_ns) for sequence, log_ns in recorded]
    assert playback.finished
    assert playback.lateness.max_ns == 0


def test_a_rate_divides_every_interval(bag: Bag) -> None:
    once, twice = played(begun(bag)), played(begun(bag, rate=2.0))
    assert [sequence for sequence, _ in once] == [sequence for sequence, _ in twice]
    assert [(a - START_NS) // 2 for _, a in once] == [b - START_NS for _, b in twice]


def test_offset_duration_and_end_cut_the_bag(bag: Bag) -> None:
    whole = [sequence for sequence, _ in played(begun(bag))]
    later = played(begun(bag, start_offset_s=0.0105))
    assert [sequence for sequence, _ in later] == whole[11:]
    assert later[0][1] - START_NS == PERIOD_NS // 2
    short = played(begun(bag, start_offset_s=0.0105, duration_s=0.01))
    assert [sequence for sequence, _ in short] == whole[11:21]
    assert played(begun(bag, until_s=0.0))[-1][0] == whole[0]
    both = played(begun(bag, duration_s=0.02, until_s=0.01))
    assert [sequence for sequence, _ in both] == whole[:11]


def test_nothing_to_play_is_an_error_that_says_what_there_is(bag: Bag) -> None:
    with pytest.raises(BagError, match=r"no message of the chosen topics and time; the bag has 0\.000"):
        begun(bag, start_offset_s=3600.0)
    with pytest.raises(BagError, match="no message"):
        Playback(bag, ["/no/where"])


def test_nothing_is_due_in_a_pause_and_the_spacing_goes_on_after_it(bag: Bag) -> None:
    playback = begun(bag)
    before = played(playback, START_NS + 10 * PERIOD_NS)
    pause_ns = before[-1][1] + PERIOD_NS // 4
    playback.toggle(pause_ns)
    assert playback.due_ns() is None
    at_ns = playback.position_ns(pause_ns + 10**9)
    assert at_ns == before[-1][1] - START_NS + PERIOD_NS // 4
    playback.toggle(pause_ns + 10**9)
    assert playback.due_ns() == pause_ns + 10**9 + 3 * PERIOD_NS // 4


def test_a_step_plays_one_message_of_a_pause_and_is_not_late(bag: Bag) -> None:
    playback = begun(bag)
    assert playback.step(START_NS) is None
    playback.toggle(START_NS)
    steps = [playback.step(START_NS + 10**10) for _ in range(3)]
    assert [message.sequence for message in steps if message is not None] == [1, 2, 3]
    assert playback.lateness.count == 0
    playback.toggle(START_NS + 2 * 10**10)
    assert playback.due_ns() == START_NS + 2 * 10**10 + PERIOD_NS


def test_a_new_rate_holds_from_now_on(bag: Bag) -> None:
    playback = begun(bag)
    last_ns = played(playback, START_NS + 10 * PERIOD_NS)[-1][1]
    playback.set_rate(0.5, last_ns)
    assert playback.due_ns() == last_ns + 2 * PERIOD_NS
    playback.set_rate(1e9, last_ns)
    assert playback.rate == 1000.0


def test_a_seek_goes_on_from_there_and_stays_within_the_bag(bag: Bag) -> None:
    playback = begun(bag)
    playback.seek(50 * PERIOD_NS, START_NS)
    assert played(playback, START_NS)[0][0] == 51
    playback.seek(-(10**9), START_NS)
    assert played(playback, START_NS)[0][0] == 1
    playback.seek(10**12, START_NS)
    assert played(playback)[-1][0] == 100
    assert playback.finished


def test_a_loop_begins_again_without_end(bag: Bag) -> None:
    playback = begun(bag, loop=True)
    sequences = []
    for _ in range(250):
        due_ns = playback.due_ns()
        assert due_ns is not None
        sequences.append(playback.next_due(due_ns).sequence)
    assert sequences == [*range(1, 101), *range(1, 101), *range(1, 51)]


def test_a_late_player_says_so_and_catches_up_in_order(bag: Bag) -> None:
    playback = begun(bag)
    late_ns = START_NS + 30 * PERIOD_NS
    sequences = []
    while (due_ns := playback.due_ns()) is not None and due_ns <= late_ns:
        sequences.append(playback.next_due(late_ns).sequence)
    assert sequences == list(range(1, 32))
    late = playback.lateness
    assert (late.count, late.max_ns) == (31, 30 * PERIOD_NS)
    assert late.percentile_s(50) == pytest.approx(15 * PERIOD_NS / 1e9, rel=0.0626)  # as wide as its classes
    assert played(playback)[0] == (32, late_ns + PERIOD_NS)


@settings(deadline=None, max_examples=30, suppress_health_check=list(HealthCheck))
@given(
    deeds=st.lists(
        st.tuples(st.sampled_from(["play", "toggle", "rate", "seek", "step"]), st.integers(0, 40)),
        max_size=30,
    )
)
def test_whatever_is_pressed_messages_come_in_order_and_never_early(
    bag: Bag, deeds: list[tuple[str, int]]
) -> None:
    playback, now_ns, last = begun(bag), START_NS, 0
    for deed, number in deeds:
        now_ns += number * PERIOD_NS // 3
        if deed == "play":
            while (due_ns := playback.due_ns()) is not None and due_ns <= now_ns:
                message = playback.next_due(now_ns)
                assert message.sequence == last + 1
                last = message.sequence
        elif deed == "step" and (stepped := playback.step(now_ns)) is not None:
            assert stepped.sequence == last + 1
            last = stepped.sequence
        elif deed == "toggle":
            playback.toggle(now_ns)
        elif deed == "rate":
            playback.set_rate(0.25 * (number + 1), now_ns)
        elif deed == "seek":
            playback.seek(number * PERIOD_NS, now_ns)
            last = number
        position_ns = playback.position_ns(now_ns)
        assert last == 100 or max(last - 1, 0) * PERIOD_NS <= position_ns <= last * PERIOD_NS
    assert playback.lateness.percentile_s(0) >= 0.0
