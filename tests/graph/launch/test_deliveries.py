"""Deliveries as the register has them, in graphs of a source and its readers."""

from __future__ import annotations

import sys

import pytest

from palp_core.graph.launch.delivery_measures import SLOW_S, Reader, Source, measure_deliveries, run
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.bench import Bench
from palp_core.methods import choose, find, names

COUNT = 40


@pytest.mark.parametrize(
    ("scene", "chosen"),
    [
        ({"wall_clock": 0.0, "process_count": 1.0}, "composed"),
        ({"wall_clock": 0.0, "process_count": 10.0}, "lockstep"),
        ({"wall_clock": 1.0, "process_count": 10.0, "reader_load": 0.1}, Qos().reliability),
    ],
)
def test_what_a_launch_file_gets_unasked_is_what_the_register_chooses(
    scene: dict[str, float], chosen: str
) -> None:
    assert choose("delivery", "lost", 0.0, scene).name == chosen


def test_a_reader_that_is_too_slow_is_told_to_take_the_latest_only() -> None:
    scene = {"wall_clock": 1.0, "reader_load": 2.0, "reader_s": SLOW_S, "depth": 10.0}
    assert choose("delivery", "age_s", 0.05, scene).name == "best_effort"
    assert find("delivery", "reliable").survivor == "best_effort"


def test_each_names_the_class_that_does_it() -> None:
    made = {name: find("delivery", name).target().__name__ for name in names("delivery")}
    assert made == {
        "composed": "Composition",
        "lockstep": "Conductor",
        "reliable": "ReorderBuffer",
        "best_effort": "TopicReceiver",
    }


@pytest.mark.parametrize("compose", [True, False], ids=["composed", "lockstep"])
def test_in_simulated_time_nothing_is_lost_and_nothing_ages(compose: bool) -> None:
    path = list(sys.path)
    found, own_s = run({"reader": ("reliable", 0.0)}, clock="sim", compose=compose, count=COUNT)
    assert found["reader"]["ages_s"] == [0.0] * COUNT
    assert own_s > 0.0
    assert sys.path == path


def test_on_the_wall_clock_a_slow_reliable_reader_has_all() -> None:
    found, _ = run({"reader": ("reliable", SLOW_S)}, clock="wall", count=COUNT)
    assert len(found["reader"]["ages_s"]) == COUNT
    assert found["source"]["cpu_s"] > 0.0


def test_the_nodes_that_measure_say_what_they_have_seen() -> None:
    source = Bench(Source, {"count": 3, "rate_hz": 100.0})
    source.advance(0.1)
    assert [block.number for block in source.sent(Source.block)] == [1, 2, 3]
    reader = Bench(Reader, {"count": 3})
    reader.advance(0.5)
    reader.feed(Reader.block, *source.sent(Source.block))
    assert reader.node.state.ages_s == pytest.approx([0.49, 0.48, 0.47], abs=0.011)


@pytest.mark.nightly
def test_all_are_measured_and_keep_their_bounds() -> None:
    found = list(measure_deliveries(None))
    assert {one.method for one in found} == set(names("delivery"))
    for one in found:
        slow = "2 times as slow" in one.condition
        scene = {"wall_clock": float(one.method in ("reliable", "best_effort")), "process_count": 1.0}
        scene |= {"reader_load": 2.0 if slow else 0.1, "reader_s": SLOW_S, "depth": 10.0}
        bound = find("delivery", one.method).bound(one.output, scene)
        assert not (one.output == "lost" and bound is not None and one.error > bound), one
        failing = (one.method, one.output) in (("reliable", "age_s"), ("best_effort", "lost"))
        assert bool(one.fails) == (slow and failing), one
