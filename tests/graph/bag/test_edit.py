from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palp_core.graph.bag.diff import diff_bags
from palp_core.graph.bag.edit import rewrite
from palp_core.graph.bag.info import bag_info
from palp_core.graph.bag.reader import Bag, read
from palp_core.graph.bag.recorder import SUMMARY_NAME
from palp_core.graph.bag.writer import BagWriter


def is_block(topic: str) -> bool:
    return topic == "/torque/block"


def test_a_filter_keeps_topics_and_time_and_the_launch_file(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert rewrite([bag], out, select=is_block, start_ns=0, end_ns=10_000_000) == 10
    assert [m.sequence for m in read(out)] == list(range(1, 11))
    with Bag(out) as opened:
        assert opened.attachments() == {"launch.yaml": b"graph: rig\n"}
    assert bag_info(out).complete


@pytest.mark.parametrize("limit", [{"max_duration_ns": 50_000_000}, {"max_bytes": 5000}])
def test_a_split_bag_is_the_same_bag(bag: Path, tmp_path: Path, limit: dict[str, int]) -> None:
    assert rewrite([bag], tmp_path / "out", **limit) == 202  # type: ignore[arg-type]
    assert len(list((tmp_path / "out").glob("*.mcap"))) > 1
    assert not any(d.first for d in diff_bags(bag, tmp_path / "out").values())
    with Bag(tmp_path / "out") as opened:
        assert SUMMARY_NAME in opened.attachments()


def test_a_merge_is_in_the_order_of_time_and_keeps_what_is_attached_once(bag: Path, tmp_path: Path) -> None:
    late, early, other, out = (tmp_path / name for name in ("late", "early", "other", "out"))
    rewrite([bag], late, start_ns=100_000_000)
    rewrite([bag], early, end_ns=100_000_000)
    with BagWriter(other) as writer:
        writer.attach("launch.yaml", b"graph: other\n")
    assert rewrite([late, early, other], out) == 202
    times = [m.log_ns for m in read(out)]
    assert times == sorted(times)
    assert not any(d.first for d in diff_bags(bag, out).values())
    with Bag(out) as opened:
        assert opened.attachments() == {
            "launch.yaml": b"graph: rig\n",
            "other/launch.yaml": b"graph: other\n",
        }
    rewrite([bag, bag], tmp_path / "twice")
    block = bag_info(tmp_path / "twice").topics["/torque/block"]
    assert (block.repeated, block.lost) == (200, 0)


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


@pytest.mark.parametrize(
    ("other", "options", "first"),
    [
        ({"change_n_m": 1e-3}, {}, "message 4 (epoch 0, sequence 5): torque_n_m[1]: 1.0 != 1.001"),
        ({"change_n_m": 1e-3}, {"tolerance": 1.1e-3}, ""),
        ({"change_n_m": 1e-3}, {"tolerance": 0.9e-3}, "torque_n_m[1]"),
        ({"change_n_m": 1e-3}, {"relative": 1.1e-3}, ""),
        ({"change_n_m": 1e-3}, {"ignore": ["torque_n_m"]}, ""),
        ({"change_n_m": 0.0, "text": "y"}, {"tolerance": 1.0}, "sequence 1): text: "),
        ({"change_n_m": 0.0, "counts": [1]}, {}, "counts (length): 0 != 1"),
    ],
)
def test_the_first_difference_that_counts_is_named(
    tmp_path: Path, kit: Any, other: dict[str, Any], options: dict[str, Any], first: str
) -> None:
    (result,) = diff_bags(
        altered(kit, tmp_path / "a", 0.0), altered(kit, tmp_path / "b", **other), **options
    ).values()
    if not first:
        assert (result.first, result.equal_count, result.close_count) == (None, 9, 1)
    else:
        assert result.first is not None
        assert first in result.first.text()


def test_a_missing_message_and_a_missing_topic_are_differences(bag: Path, tmp_path: Path) -> None:
    rewrite([bag], tmp_path / "short", select=is_block, end_ns=150_000_000)
    found = diff_bags(bag, tmp_path / "short")
    block, mode = found["/torque/block"].first, found["/policy/mode"].first
    assert block is not None
    assert mode is not None
    assert (block.place, block.a, block.b) == (150, "there", "missing")
    assert (mode.place, mode.b) == (0, "missing")
    assert (found["/torque/block"].count_a, found["/torque/block"].count_b) == (200, 150)
