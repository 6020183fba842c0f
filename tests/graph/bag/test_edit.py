from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palp_core.errors import BagError
from palp_core.graph.bag.diff import diff_bags
from palp_core.graph.bag.edit import filter_bag, merge_bags, split_bag
from palp_core.graph.bag.info import bag_info
from palp_core.graph.bag.reader import Bag, read
from palp_core.graph.bag.recorder import SUMMARY_NAME


def test_a_filter_keeps_topics_and_time_and_the_launch_file(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert filter_bag(bag, out, select=lambda t: t == "/torque/block", start_ns=0, end_ns=10_000_000) == 10
    assert [m.sequence for m in read(out)] == list(range(1, 11))
    with Bag(out) as opened:
        assert opened.attachments() == {"launch.yaml": b"graph: rig\n"}
    assert bag_info(out).complete


def test_a_split_bag_is_the_same_bag(bag: Path, tmp_path: Path) -> None:
    assert split_bag(bag, tmp_path / "a", max_duration_ns=50_000_000) == 202
    assert split_bag(bag, tmp_path / "b", max_bytes=5000) == 202
    assert len(list((tmp_path / "a").glob("*.mcap"))) == 4
    for name in "ab":
        assert not any(d.first for d in diff_bags(bag, tmp_path / name).values())
    with Bag(tmp_path / "a") as opened:
        assert SUMMARY_NAME in opened.attachments()
    with pytest.raises(BagError, match="largest size"):
        split_bag(bag, tmp_path / "c")


def test_a_merge_is_in_the_order_of_time(bag: Path, tmp_path: Path) -> None:
    filter_bag(bag, tmp_path / "late", start_ns=100_000_000)
    filter_bag(bag, tmp_path / "early", end_ns=100_000_000)
    assert merge_bags([tmp_path / "late", tmp_path / "early"], tmp_path / "out") == 202
    times = [m.log_ns for m in read(tmp_path / "out")]
    assert times == sorted(times)
    assert not any(d.first for d in diff_bags(bag, tmp_path / "out").values())
    assert bag_info(tmp_path / "out").attachments == ["launch.yaml"]


def test_other_attachments_of_the_same_name_are_kept_beside(bag: Path, tmp_path: Path, kit: Any) -> None:
    from palp_core.graph.bag.writer import BagWriter

    with BagWriter(tmp_path / "other") as writer:
        writer.attach("launch.yaml", b"graph: other\n")
    merge_bags([bag, tmp_path / "other"], tmp_path / "out")
    with Bag(tmp_path / "out") as opened:
        assert opened.attachments() == {
            "launch.yaml": b"graph: rig\n",
            "other/launch.yaml": b"graph: other\n",
        }


def test_repeats_of_a_merge_are_told(bag: Path, tmp_path: Path) -> None:
    merge_bags([bag, bag], tmp_path / "out")
    info = bag_info(tmp_path / "out")
    assert info.topics["/torque/block"].repeated == 200
    assert info.topics["/torque/block"].lost == 0


def altered(kit: Any, folder: Path, change_n_m: float, **options: Any) -> Path:
    frames = []
    for i in range(10):
        torque_n_m = np.full(3, 1.0)
        if i == 4:
            torque_n_m[1] += change_n_m
        block = kit.Block(stamp_ns=i, torque_n_m=torque_n_m, **options)
        frames.append((i, kit.frame("/torque/block", block, i + 1, i)))
    bag: Path = kit.record(folder, frames)[0]
    return bag


def test_the_first_difference_is_named(tmp_path: Path, kit: Any) -> None:
    a, b = altered(kit, tmp_path / "a", 0.0), altered(kit, tmp_path / "b", 1e-3)
    (result,) = diff_bags(a, b).values()
    assert result.first is not None
    assert result.equal_count == 4
    assert (result.first.sequence, result.first.field) == (5, "torque_n_m[1]")
    assert result.first.text() == "message 4 (epoch 0, sequence 5): torque_n_m[1]: 1.0 != 1.001"


def test_a_tolerance_passes_what_is_within_it(tmp_path: Path, kit: Any) -> None:
    a, b = altered(kit, tmp_path / "a", 0.0), altered(kit, tmp_path / "b", 1e-3)
    for options, passes in (
        ({"tolerance": 1.1e-3}, True),
        ({"tolerance": 0.9e-3}, False),
        ({"relative": 1.1e-3}, True),
        ({"ignore": ["torque_n_m"]}, True),
    ):
        (result,) = diff_bags(a, b, **options).values()
        assert (result.first is None) == passes
        assert result.close_count == passes


def test_a_missing_message_and_a_missing_topic_are_differences(bag: Path, tmp_path: Path) -> None:
    filter_bag(bag, tmp_path / "short", select=lambda t: t == "/torque/block", end_ns=150_000_000)
    found = diff_bags(bag, tmp_path / "short")
    block, mode = found["/torque/block"].first, found["/policy/mode"].first
    assert block is not None
    assert mode is not None
    assert (block.place, block.a, block.b) == (150, "there", "missing")
    assert (mode.place, mode.b) == (0, "missing")
    assert (found["/torque/block"].count_a, found["/torque/block"].count_b) == (200, 150)


def test_text_and_structure_differ_too(tmp_path: Path, kit: Any) -> None:
    a = altered(kit, tmp_path / "a", 0.0, text="x")
    b = altered(kit, tmp_path / "b", 0.0, text="y")
    c = altered(kit, tmp_path / "c", 0.0, text="x", counts=[1])
    assert diff_bags(a, b, tolerance=1.0)["/torque/block"].first.field == "text"  # type: ignore[union-attr]
    assert diff_bags(a, c)["/torque/block"].first.field == "counts (length)"  # type: ignore[union-attr]
