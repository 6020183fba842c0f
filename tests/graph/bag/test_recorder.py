from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palp_core.graph.bag.account import Gap, TopicAccount
from palp_core.graph.bag.info import bag_info
from palp_core.graph.bag.reader import Bag, read, topic_selection
from palp_core.graph.bag.recorder import BagRecorder
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.builtin import Progress
from palp_core.graph.messages.frame import Kind, parse
from palp_core.graph.recording.live_recorder import SnapshotRecorder

MODE = "/policy/mode"


def mode(kit: Any, sequence: int, **options: Any) -> bytes:
    raw: bytes = kit.frame("/policy/mode", kit.Mode(stamp_ns=sequence, level=0.0), sequence, 10, **options)
    return raw


def recorded(kit: Any, folder: Path, frames: list[bytes], **options: Any) -> Any:
    recorder = BagRecorder(BagWriter(folder), kit.TOPICS, **options)
    for now_ns, raw in enumerate(frames):
        recorder(now_ns, raw)
    return recorder.close()


def test_payloads_sequences_and_times_are_those_of_the_wire(tmp_path: Path, kit: Any) -> None:
    frames = kit.run_frames(50)
    bag, summary = kit.record(tmp_path / "run", frames)
    assert summary.complete
    with Bag(bag) as opened:
        for (now_ns, raw), message in zip(frames, opened.recorded(), strict=True):
            wire = parse(raw)
            assert message.payload == wire.payload
            assert (message.stream.topic.name, message.sequence) == (wire.topic, wire.sequence)
            assert (message.log_ns, message.publish_ns) == (now_ns, wire.stamp_ns)


def test_of_files_that_are_no_longer_kept_the_account_has_how_much_they_held(
    tmp_path: Path, kit: Any
) -> None:
    writer = BagWriter(tmp_path / "run", max_duration_ns=10, max_files=2)
    with BagRecorder(writer, kit.TOPICS) as recorder:
        for now_ns in range(100):
            recorder(now_ns, mode(kit, now_ns + 1))
    summary = recorder.close()
    assert summary.topics[MODE].count + summary.topics[MODE].deleted == 100
    assert summary.text() == "20 messages on 1 topic (80 older messages no longer kept), nothing missing"
    info = bag_info(tmp_path / "run")
    assert info.complete
    assert info.topics[MODE].count == 20 + 1  # the latched one that the oldest file repeats
    assert [message.sequence for message in read(tmp_path / "run")][-1] == 100


BEAT, MOVED = Kind.HEARTBEAT, Kind.MOVED


@pytest.mark.parametrize(
    ("received", "late", "count", "gaps"),
    [
        pytest.param([1, 2, 5, 6, (1, 1), (1, 2)], False, 6, [Gap(0, 3, 4)], id="a restart is no gap"),
        pytest.param([1, (1, 3)], False, 2, [Gap(1, 1, 2)], id="a restart that begins late"),
        pytest.param([1, (0, 4, BEAT)], False, 1, [Gap(0, 2, 4)], id="a heartbeat reveals a lost tail"),
        pytest.param([(0, 4, BEAT)], False, 0, [Gap(0, 1, 4)], id="a topic that was lost whole"),
        pytest.param([1, (0, 3, MOVED)], False, 1, [Gap(0, 2, 3)], id="a publisher that moves"),
        pytest.param([7, 8], True, 2, [], id="a late recorder counts from what it meets"),
        pytest.param([7], False, 1, [Gap(0, 1, 6)], id="one that is not late misses the beginning"),
        pytest.param([(0, 4, BEAT), 6], True, 1, [Gap(0, 5, 5)], id="a late one meets a heartbeat"),
        pytest.param([1, 4, 2, 3, 3], False, 4, [], id="late fillings and repeats differ"),
    ],
)
def test_each_message_is_in_the_bag_or_in_a_gap_that_was_named_once(
    tmp_path: Path, kit: Any, received: list[Any], late: bool, count: int, gaps: list[Gap]
) -> None:
    recorder = BagRecorder(BagWriter(tmp_path / "run"), kit.TOPICS, from_start=not late)
    missed: list[Gap] = []
    recorder.missed = lambda _, *gap: missed.append(Gap(*gap))
    for now_ns, entry in enumerate(received):
        epoch, sequence, kind = (0, entry, Kind.DATA) if isinstance(entry, int) else (*entry, Kind.DATA)[:3]
        for _ in range(1 if kind == Kind.DATA else 2):
            recorder(now_ns, mode(kit, sequence, epoch=epoch, kind=kind))
    summary = recorder.close()
    topic = summary.topics[MODE]
    assert (topic.count, topic.lost, topic.gaps) == (count, sum(gap.count for gap in gaps), gaps)
    numbers = [entry for entry in received if isinstance(entry, int)]
    assert topic.repeated == len(numbers) - len(set(numbers))
    assert set(gaps) <= set(missed)
    assert len(set(missed)) == len(missed)
    assert all(f"{gap.first}..{gap.last}" in summary.text() for gap in gaps)
    info = bag_info(tmp_path / "run")
    assert info.complete == (not gaps)
    if count:
        assert (info.healthy, info.topics[MODE].gaps) == (True, gaps)
    else:
        assert info.problems == [f"{MODE}: all of 4 messages missing"]


@pytest.mark.parametrize("is_expected_first", [True, False])
def test_what_was_asked_for_is_taken_where_it_is_missing_and_only_there(
    tmp_path: Path, kit: Any, is_expected_first: bool
) -> None:
    recorder = BagRecorder(BagWriter(tmp_path / "run"), kit.TOPICS, from_start=False)
    missed: list[tuple[Any, ...]] = []
    recorder.missed = lambda *gap: missed.append(gap)
    if is_expected_first:
        recorder.expect_from(MODE, 0, 1)
    for sequence in (2, 5):
        recorder(0, mode(kit, sequence))
    recorder.expect_from(MODE, 0, 1)
    recorder.expect_from(MODE, 0, 3)
    assert sorted(missed) == [(MODE, 0, 1, 1), (MODE, 0, 3, 4)]
    for sequence in (1, 2, 3, 4, 4, 5):
        recorder.fill(1, mode(kit, sequence))
    assert recorder.taken == 5
    topic = recorder.close().topics[MODE]
    assert (topic.count, topic.lost, topic.repeated) == (5, 0, 0)


def test_sequences_beyond_32_bits_keep_their_value(tmp_path: Path, kit: Any) -> None:
    sequences = [2**32 - 1, 2**32, 2**32 + 1]
    assert recorded(kit, tmp_path / "run", [mode(kit, s) for s in sequences], from_start=False).complete
    assert [m.sequence for m in read(tmp_path / "run")] == sequences


def test_foreign_frames_and_unknown_types_lose_nothing(tmp_path: Path, kit: Any) -> None:
    stranger = kit.frame("/cup/mode", kit.Mode(stamp_ns=0, level=2.0), 1, 0)
    other = kit.frame("/policy/mode", kit.Place(depth_m=0.1), 1, 0)
    summary = recorded(
        kit, tmp_path / "run", [stranger, other, mode(kit, 2), b"noise", b"", mode(kit, 3)[:20]]
    )
    assert summary.unreadable == 3
    assert not summary.complete
    assert not summary.topics["/cup/mode"].described
    values = [m.value for m in read(tmp_path / "run")]
    assert values[0] == {"stamp_ns": 0, "level": 2.0}
    assert values[1] == {"depth_m": 0.1}
    assert values[2].level == 0.0


def test_a_stamp_before_the_start_is_refused_and_counted(tmp_path: Path, kit: Any) -> None:
    early = kit.frame("/policy/mode", kit.Mode(stamp_ns=0, level=0.0), 2, -5)
    summary = recorded(kit, tmp_path / "run", [mode(kit, 1), early, mode(kit, 3)])
    assert summary.topics["/policy/mode"].refused == 1
    assert summary.topics["/policy/mode"].lost == 1
    assert not bag_info(tmp_path / "run").complete


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (([], None, None), ["/policy/mode", "/torque/block"]),
        ((["/torque/block"], None, None), ["/torque/block"]),
        ((["/torque/block"], "mode$", None), ["/policy/mode", "/torque/block"]),
        (([], None, "^/torque"), ["/policy/mode"]),
    ],
)
def test_only_selected_topics_are_recorded(
    tmp_path: Path, kit: Any, arguments: Any, expected: list[str]
) -> None:
    select = topic_selection(*arguments)
    recorder = BagRecorder(BagWriter(tmp_path / "run"), kit.TOPICS, select=select)
    for now_ns, raw in kit.run_frames(5):
        recorder(now_ns, raw)
    assert list(recorder.close().topics) == expected


def test_the_runtimes_own_messages_need_no_description(tmp_path: Path, kit: Any) -> None:
    progress = Progress(stamp_ns=0, phase="train", done_count=1, total_count=2)
    summary = recorded(kit, tmp_path / "run", [kit.frame("/x/progress", progress, 1, 0)])
    assert summary.topics["/x/progress"].described
    (message,) = read(tmp_path / "run")
    assert message.value.phase == "train"


def test_a_snapshot_holds_the_last_seconds_and_the_latched_values(tmp_path: Path, kit: Any) -> None:
    snapshot = SnapshotRecorder(20_000_000, kit.TOPICS)
    for now_ns, raw in kit.run_frames(100):
        snapshot(now_ns, raw)
    recorder = BagRecorder(BagWriter(tmp_path / "run"), kit.TOPICS, from_start=False)
    snapshot.save(recorder)
    assert recorder.close().complete
    found = [(m.topic, m.sequence) for m in read(tmp_path / "run")]
    assert found == [("/policy/mode", 2), *(("/torque/block", s) for s in range(80, 101))]


@given(
    order=st.permutations(range(1, 12)), kept=st.sets(st.integers(1, 11)), again=st.sets(st.integers(1, 11))
)
def test_the_account_is_a_set_of_sequences(order: list[int], kept: set[int], again: set[int]) -> None:
    account = TopicAccount(from_start=True)
    epoch = account.epoch(0)
    for sequence in [*(s for s in order if s in kept), *(kept & again)]:
        epoch.add(sequence)
    epoch.expect(11)
    missing = {s for gap in account.gaps for s in range(gap.first, gap.last + 1)}
    assert missing == set(range(1, 12)) - kept
    assert all(epoch.lacks(s) == (s in missing) for s in range(13))
    assert (account.lost, account.count, account.repeated) == (len(missing), len(kept), len(kept & again))
