from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.graph.bag.account import Gap, TopicAccount
from palp_core.graph.bag.info import bag_info
from palp_core.graph.bag.reader import Bag, read, topic_selection
from palp_core.graph.bag.recorder import BagRecorder
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.builtin import Progress
from palp_core.graph.messages.frame import Kind, parse
from palp_core.graph.recording.snapshot import SnapshotRecorder


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


def test_a_gap_is_named_and_a_restart_is_none(tmp_path: Path, kit: Any) -> None:
    frames = [mode(kit, s) for s in (1, 2, 5, 6)] + [mode(kit, s, epoch=1) for s in (1, 2)]
    summary = recorded(kit, tmp_path / "run", frames)
    topic = summary.topics["/policy/mode"]
    assert (topic.count, topic.lost, topic.gaps) == (6, 2, [Gap(0, 3, 4)])
    assert "/policy/mode: 2 missing of 8: 3..4" in summary.text()
    info = bag_info(tmp_path / "run")
    assert info.topics["/policy/mode"].epochs == 2
    assert info.topics["/policy/mode"].gaps == [Gap(0, 3, 4)]
    assert info.healthy
    assert not info.complete


def test_a_restart_that_begins_late_has_lost_its_head(tmp_path: Path, kit: Any) -> None:
    summary = recorded(kit, tmp_path / "run", [mode(kit, 1), mode(kit, 3, epoch=1)])
    assert summary.topics["/policy/mode"].gaps == [Gap(1, 1, 2)]


def test_a_heartbeat_reveals_a_lost_tail_and_a_topic_lost_whole(tmp_path: Path, kit: Any) -> None:
    beat = mode(kit, 4, kind=Kind.HEARTBEAT)
    summary = recorded(kit, tmp_path / "a", [mode(kit, 1), beat])
    assert summary.topics["/policy/mode"].gaps == [Gap(0, 2, 4)]
    assert bag_info(tmp_path / "a").topics["/policy/mode"].lost == 3
    assert recorded(kit, tmp_path / "b", [beat]).topics["/policy/mode"].lost == 4
    assert any("all of 4 messages missing" in problem for problem in bag_info(tmp_path / "b").problems)


def test_a_recorder_that_comes_late_counts_from_what_it_meets(tmp_path: Path, kit: Any) -> None:
    late = recorded(kit, tmp_path / "a", [mode(kit, 7), mode(kit, 8)], from_start=False)
    assert late.complete
    assert recorded(kit, tmp_path / "b", [mode(kit, 7)]).topics["/policy/mode"].gaps == [Gap(0, 1, 6)]
    beat = mode(kit, 4, kind=Kind.HEARTBEAT)
    met = recorded(kit, tmp_path / "c", [beat, mode(kit, 6)], from_start=False)
    assert met.topics["/policy/mode"].gaps == [Gap(0, 5, 5)]


def test_late_fillings_and_repeats_are_told_apart(tmp_path: Path, kit: Any) -> None:
    summary = recorded(kit, tmp_path / "run", [mode(kit, s) for s in (1, 4, 2, 3, 3)])
    topic = summary.topics["/policy/mode"]
    assert (topic.count, topic.lost, topic.repeated) == (4, 0, 1)


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


def test_a_stamp_before_the_start_is_refused_and_told(tmp_path: Path, kit: Any) -> None:
    early = kit.frame("/policy/mode", kit.Mode(stamp_ns=0, level=0.0), 2, -5)
    summary = recorded(kit, tmp_path / "run", [mode(kit, 1), early, mode(kit, 3)])
    assert summary.topics["/policy/mode"].refused == 1
    assert summary.topics["/policy/mode"].lost == 1
    assert not bag_info(tmp_path / "run").complete


def test_only_selected_topics_are_recorded(tmp_path: Path, kit: Any) -> None:
    select = topic_selection((), "mode$", "^/torque")
    recorder = BagRecorder(BagWriter(tmp_path / "run"), kit.TOPICS, select=select)
    for now_ns, raw in kit.run_frames(5):
        recorder(now_ns, raw)
    assert list(recorder.close().topics) == ["/policy/mode"]


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


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (([], None, None), ["/a/x", "/b/y"]),
        ((["/a/x"], None, None), ["/a/x"]),
        (([], "b", None), ["/b/y"]),
        ((["/a/x"], "b", None), ["/a/x", "/b/y"]),
        (([], None, "^/a"), ["/b/y"]),
    ],
)
def test_topics_are_chosen_by_name_and_expression(arguments: Any, expected: list[str]) -> None:
    assert [t for t in ("/a/x", "/b/y") if topic_selection(*arguments)(t)] == expected


@settings(deadline=None, max_examples=100)
@given(
    order=st.permutations(range(1, 12)), kept=st.sets(st.integers(1, 11)), again=st.sets(st.integers(1, 11))
)
def test_the_account_is_a_set_of_sequences(order: list[int], kept: set[int], again: set[int]) -> None:
    account = TopicAccount(from_start=True)
    seen = [s for s in order if s in kept]
    for sequence in [*seen, *(kept & again)]:
        account.epoch(0).add(sequence)
    account.epoch(0).expect(11)
    missing = {s for gap in account.gaps for s in range(gap.first, gap.last + 1)}
    assert missing == set(range(1, 12)) - kept
    assert account.lost == len(missing)
    assert account.count == len(kept)
    assert account.repeated == len(kept & again)
