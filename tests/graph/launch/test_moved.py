"""Launch files, commands and bags that name code by its place in earlier versions go on working."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from palp_core import moved
from palp_core.graph.description.node_class import NodeClassRequest, inspect_classes
from palp_core.graph.launch.graph import check_file
from palp_core.graph.launch.summary import report_function
from palp_core.graph.node.loading import load_class
from palp_core.graph.recording.recorder_node import Recorder
from palp_core.graph.replay.player import Player
from palp_core.graph.replay.replay import replay
from palp_core.palpation.session.report import session
from tests.support.palp import Palp

OLD_RECORDER = "palp_core.bag.record:Recorder"
OLD_PLAYER = "palp_core.bag.player:Player"
OLD_REPORT = "palp_core.studies.report:session"
LAUNCH = f"""
graph: old
clock: sim
nodes:
  recorder: {{run: {OLD_RECORDER}, params: {{out: bag}}}}
report: {OLD_REPORT}
"""
COUNTER = """
from palp_core import Node, Params, Progress, Pub, State, every


class CounterParams(Params):
    rate_hz: float = 10.0


class CounterState(State):
    count: int = 0


class Counter(Node):
    params: CounterParams
    state: CounterState
    count = Pub(Progress)

    @every("rate_hz")
    def tick(self):
        self.state.count += 1
        said = Progress(
            stamp_ns=self.now_ns(), phase="counting", done_count=self.state.count, total_count=5
        )
        self.count.publish(said)
        if self.state.count == 5:
            self.finish()
"""
COUNTER_LAUNCH = """
graph: counter
clock: sim
nodes:
  counter: {run: counter_before:Counter, on_exit: shutdown}
"""


def test_an_old_launch_file_finds_its_recorder_and_its_report(tmp_path: Path) -> None:
    (tmp_path / "launch").mkdir()
    file = tmp_path / "launch" / "old.yaml"
    file.write_text(LAUNCH)
    graph = check_file(file)
    assert [spec.name for spec in graph.recorders] == ["recorder"]
    assert report_function(graph.report, str(tmp_path)) is session


def test_a_node_that_is_run_or_swapped_in_is_found_by_its_old_name(tmp_path: Path) -> None:
    (found,) = inspect_classes([NodeClassRequest(OLD_RECORDER, {"out": "bag"})], tmp_path)
    assert found.error is None
    assert load_class(OLD_RECORDER, str(tmp_path)) is Recorder
    assert load_class(OLD_PLAYER, str(tmp_path), fresh=False) is Player


def test_palp_run_finds_a_node_by_its_old_name(palp: Palp, tmp_path: Path) -> None:
    done = palp.run("run", OLD_PLAYER, "-n", "torque", "-p", f"bag:={tmp_path / 'bag'}")
    assert done.returncode == 2
    assert f"{tmp_path / 'bag'}: no such bag" in done.stderr


def test_a_bag_of_a_node_that_has_moved_is_replayed(
    palp: Palp, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "counter.yaml").write_text(COUNTER_LAUNCH)
    (tmp_path / "counter_before.py").write_text(COUNTER)
    done = palp.here("launch", tmp_path / "counter.yaml", "--record", tmp_path / "bag")
    assert done.returncode == 0, done.stderr
    (tmp_path / "counter_before.py").rename(tmp_path / "counter_now.py")
    monkeypatch.setitem(moved._MOVED, "counter_before", "counter_now")
    monkeypatch.setattr(sys, "path", sys.path.copy())
    (found,) = replay(tmp_path / "bag", ["counter"], tmp_path)
    assert found.divergence is None
    assert found.compared > 0
