"""The page of the rig without a browser: NiceGUI's simulated user over a source that a test speaks for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from palp_core.graph.messages.topic import Topic
from palp_core.palpation.live_page.monitor import RigMonitor
from palp_core.palpation.live_page.page import rig
from palp_core.palpation.session.trials_csv import Row, SessionWriter
from palp_core.view.source.overview import NodeState, Overview
from palp_core.view.source.protocol import ViewSource

pytest.importorskip("nicegui")
pytest.importorskip("nicegui.testing.user_simulation")

from palp_core.palpation.live_page.drawing.panels import (
    OutcomePanel,
    TouchPanel,
    bars,
    lift_of,
    muscle_text,
)
from palp_core.palpation.live_page.drawing.strip import _Acknowledge
from palp_core.palpation.live_page.safety import safety_status
from palp_core.view.pages.parts import MOST_UNDER_WAY
from palp_core.view.pages.viewer import OwnPage, Viewer
from palp_core.view.source.operator import NOT_OPERATED
from tests.support.view.fake_source import FakeOperator, FakeSource
from tests.support.view.simulated_user import simulated

DEPTHS_M = [0.002, 0.004, 0.008]
BEAT = {"state": "ready", "permits": True, "cause": "", "text": "", "warning": ""}
PUBLISHED: dict[str, list[tuple[int, dict[str, Any]]]] = {
    "SafetyBeat": [(90, BEAT)],
    "Mount": [(1, {"code": "K7", "remount": 0})],
    "PhantomTruth": [(1, {"code": "B", "depth_m": 0.004})],
    "PrimitivesLearnt": [
        (2, {
            "depths_m": DEPTHS_M, "rings_m": [0.016], "mean_n_m": [0.04, 0.03, 0.02], "sd_n_m": [0.001] * 3,
            "count": [25.0] * 3,
        }),
    ],
    "RingState": [(3, {"target_m": 0.016, "measured_m": 0.0162, "settled": True, "rehome": False})],
    "RingReport": [(3, {"text": ""})],
    "Trial": [(4, {"trial": 5, "phase": "estimation", "label_known": False, "depth_m": 0.0})],
    "Belief": [
        (5, {
            "trial": 5, "iteration": 1, "depths_m": DEPTHS_M, "posterior": [0.1, 0.7, 0.2],
            "gain": [0.1, 0.2, 0.3],
            "verdict": "continue",
        }),
    ],
    "TrialResult": [
        (3, {"trial": 4, "estimate_m": 0.004, "confidence": 0.97, "probe_count": 2, "verdict": "decided"}),
    ],
    "PolicyChange": [(2, {"trial": 4, "iteration": 2, "policy": "uniform"})],
    "ContactGuard": [(4, {"words": ["gel thinner than l2 is bounded for: l4"]})],
    "Progress": [
        (6, {"phase": "estimation", "done_count": 1, "total_count": 300, "text": "right: 4 mm 1 of 1"}),
    ],
    "CoContraction": [
        (7, {
            "level": 4, "level_defined": True, "burst_count": 1, "value": [0.5], "stamp_ns": 7, "start_ns": 0,
            "rate_hz": 1500.0,
        }),
    ],
    "StagePose": [(8, {"goal_id": 1, "start_ns": 0, "rate_hz": 1000.0, "position_m": [0.0, 0.001]})],
    "TorqueBlock": [(9, {"start_ns": 0, "rate_hz": 1000.0, "torque_n_m": [0.011, 0.012]})],
}  # fmt: skip


class RigSource(FakeSource):
    """A rig whose nodes have published all of ``PUBLISHED``."""

    def __init__(self, clock: str = "wall") -> None:
        nodes = [NodeState(name="rig", run="nodes.policy_uniform:Uniform"), NodeState(name="safety")]
        value = {"type": "array", "items": {"type": "number"}}
        schema = {"type": "object", "properties": {"value": value}}
        owners = {kind: "safety" if kind == "SafetyBeat" else "rig" for kind in PUBLISHED}
        super().__init__(
            Overview(kind="graph", title="rig", clock=clock, now_s=1.0, nodes=nodes),
            [
                Topic(name=f"/{node}/{kind.lower()}", type=kind, node=node, json_schema=schema)
                for kind, node in owners.items()
            ],
        )
        self.launched = {"params": {"stage": {"from_m": -0.03, "to_m": 0.05}}}
        for kind, entries in PUBLISHED.items():
            for stamp_ns, message in entries:
                self.add(kind, stamp_ns, message)


def pressed() -> FakeOperator:
    return FakeOperator(done=True, state="starting", text="it goes on by itself")


def strip_and_page(viewer: Viewer) -> Callable[[], None]:
    own = OwnPage(rig)

    def put() -> None:
        own.fill_strip(viewer)
        own.fill(viewer)

    return put


SEEN = (
    "4 mm", "97 %", "right", "level 0.5 at its latest peak (fifth of five)",
    "gel thinner than l2 is bounded for: l4",
    "ready", "ring: 16.2 mm, settled", "phantom B", "1 of 300", "policy: nodes.policy_uniform:Uniform",
    "Not all are of one policy: uniform from trial 1 on.",
)  # fmt: skip


def test_it_shows_what_the_nodes_have_published() -> None:
    async def look(user: Any) -> None:
        for words in SEEN:
            await user.should_see(words)

    simulated(strip_and_page(Viewer(source=RigSource(), operator=pressed())), look)  # type: ignore[arg-type]


def test_a_ring_that_waits_is_shown_and_after_the_graphs_end_it_is_not_called_silent() -> None:
    source = RigSource()
    homing = {"target_m": 0.016, "measured_m": 0.016, "settled": False, "rehome": True, "stamp_ns": 1}
    source.add("RingState", 4, homing)
    source.add("RingReport", 5, {"text": "its motor waits 63 s more"})

    async def look(user: Any) -> None:
        await user.should_see("re-homing: its motor waits 63 s more")
        source.change(alive=False)
        await user.should_see("no safety node watches the rig any more")
        await user.should_not_see("is silent")

    simulated(strip_and_page(Viewer(source=source, operator=pressed())), look)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("report", "status", "lift_mm"),
    [
        ({"z_m": 0.0, "condition": "ok"}, "cancelled", 0.0),  # stopped in the gel
        ({"z_m": 0.02, "condition": "ok"}, "sweeping", 20.0),
        ({"z_m": 0.0, "condition": "closed"}, "cancelled", 20.0),
        (None, "sweeping", 0.0),
        (None, "cancelled", 20.0),
    ],
)
def test_the_probe_is_drawn_as_high_as_the_stage_says_that_it_is(
    report: dict[str, Any] | None, status: str, lift_mm: float
) -> None:
    rig_now: Any = SimpleNamespace(
        latest=lambda _: report, sweeping=status == "sweeping", path_m=(-0.03, 0.05)
    )
    assert lift_of(rig_now) == lift_mm


def test_a_trip_is_left_behind_only_when_asked_twice() -> None:
    source, operator = RigSource(), pressed()
    source.add("SafetyBeat", 91, {**BEAT, "state": "latched", "cause": "torque", "text": "105 N mm"})

    async def look(user: Any) -> None:
        await user.should_see("torque: 105 N mm")
        user.find("acknowledge ...").click()
        await user.should_see("are all hands off the rig?")
        assert operator.calls == []
        user.find("yes, leave the stop behind").click()
        await user.should_see("acknowledged: it goes on by itself")
        assert operator.calls == [("safety", "acknowledge", {}, False)]
        source.add("SafetyBeat", 92, {**BEAT, "state": "ready"})
        await user.should_see("ready")
        await user.should_see("it goes on by itself")  # and is not wiped away as the stop is left

    simulated(strip_and_page(Viewer(source=source, operator=operator)), look)  # type: ignore[arg-type]


def monitor(source: ViewSource, **how: bool) -> RigMonitor:
    found = RigMonitor(source, **how)
    found.load()
    return found


def test_what_was_asked_for_and_what_came_meanwhile_counts_once() -> None:
    source = RigSource()
    now = monitor(source)
    assert len(now.look()) == 2
    source.add("TrialResult", 60, {**PUBLISHED["TrialResult"][0][1], "trial": 5, "estimate_m": 0.008})
    assert now.look() == []
    assert [row.right for row in now.board.rows] == [True, False]
    assert len(now.belief.probes) == 1
    assert bars(now.belief)[1] == {"label": "4 mm", "share": 0.7, "text": "70.0 %", "most": True}


def test_where_sweeps_are_shown_when_they_are_over_the_ring_is_shown_as_it_was_in_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(PUBLISHED, "Palpation", [(9, {"torque_n_m": [0.01, 0.02], "ring_m": 0.004})])
    source = RigSource("sim")
    now = monitor(source, at_once=True)
    assert now.ring_m == 0.016
    assert len(now.look()) == 2
    source.add("RingState", 10, {**PUBLISHED["RingState"][0][1], "target_m": 0.008})
    now.look()
    assert now.ring is not None
    assert now.ring_m == now.ring["measured_m"] == 0.004


def test_muscles_that_have_fallen_silent_are_shown_as_that() -> None:
    last = {**PUBLISHED["CoContraction"][0][1], "stamp_ns": 69_000_000_000}
    assert "silent since 69 s" in muscle_text(last, None, 72.0)
    assert "silent" not in muscle_text(last, None, 120.0, fast=True)
    assert "silent since 69 s" in muscle_text(last, None, 5541.0, fast=True)


def test_over_a_bag_it_is_as_it_was_at_the_chosen_time() -> None:
    source = RigSource()
    source.change(now_s=4e-9)
    now = monitor(source, recorded=True)
    now.look()
    assert (now.belief.trial, now.belief.posterior, len(now.board.rows)) == (5, [], 1)
    source.change(now_s=5e-9)
    now.look()
    assert now.belief.posterior == [0.1, 0.7, 0.2]
    source.change(now_s=2e-9)
    now.look()
    assert (now.belief.posterior, now.board.rows, now.learnt) == ([], [], PUBLISHED["PrimitivesLearnt"][0][1])


def test_a_slow_browser_is_sent_no_more_than_it_takes_and_then_the_whole_sweep() -> None:
    source = RigSource()
    now = monitor(source)
    now.look()
    for peak_n_m in (0.01, 0.02):
        now.taught.add(0.002, 0.016, [0.0, peak_n_m])
    made: list[TouchPanel] = []

    def put() -> None:
        made.append(TouchPanel(now))

    async def look(user: Any) -> None:
        panel = made[-1]
        chart, sent = panel._chart, list[tuple[str, int]]()
        chart.run_method = lambda name, points, number: sent.append((name, len(points)))
        panel.show([])
        for _ in range(9):
            panel.show([(1.0, 2.0)])
        assert sent == [("begin", 2), *[("add", 1)] * (MOST_UNDER_WAY - 1)]
        for lie in ("3", None, -1, [2]):
            chart._take(SimpleNamespace(args=lie))
            assert chart.busy
        chart._take(SimpleNamespace(args=10**9))
        assert not chart.busy
        panel.show([])
        assert sent[-1] == ("begin", 2)
        moves = {"target_m": 0.004, "measured_m": 0.01, "settled": False, "rehome": False}
        source.add("RingState", 10, moves)
        now.look()
        panel.show_text()
        assert "ring: 10.0 mm, moving" in panel._facts.text
        assert panel._taught.text.endswith("ring at 16 mm")  # of the sweep that is shown

    simulated(put, look)


def test_once_training_is_over_its_sweeps_are_read_from_the_sessions_folder(tmp_path: Path) -> None:
    writer = SessionWriter(str(tmp_path / "out"), DEPTHS_M)
    writer.start()
    for number in range(6):
        row = Row(
            row=number, session="a", phase="training" if number < 4 else "estimation", phantom="B",
            remount=0, trial=number, depth_m=0.004, iteration=1, ring_m=0.016, true_ring_m=None,
            peak_n_m=0.03, posterior=[], gain=[], gamma=None, verdict="", estimate_m=None, outlier=False,
            policy="", seed=1, start_ns=0, end_ns=1,
        )  # fmt: skip
        writer.append(row, np.array([0.01, 0.03, 0.01]) + 0.001 * number, 1000.0)
    writer.close()
    source = RigSource()
    source.launched = {"folder": str(tmp_path), "params": {"rig": {"out": "out"}}}
    now = monitor(source)
    (band,) = now.bands(now.ring_m)
    assert (band.depth_mm, band.sweep_count) == (4.0, 4)
    assert not now.wants_taught

    async def look(user: Any) -> None:
        await user.should_see(str(tmp_path / "out/report.html"))  # of a graph that has ended, too

    def put() -> None:
        OutcomePanel(source, now).show()

    simulated(put, look)
    source.launched = {"params": {"rig": {"out": "out"}}}  # where that is, is unknown
    now = monitor(source)
    assert now.bands(now.ring_m) == []


STOPPED = {**BEAT, "state": "latched", "permits": False, "cause": "operator", "text": "palp view"}


@pytest.mark.parametrize("refusal", ["", NOT_OPERATED])
def test_an_acknowledgement_that_would_be_refused_is_dead_and_says_why(refusal: str) -> None:
    viewer: Any = SimpleNamespace(refusal=lambda **_: refusal, operator=None)
    shown: list[_Acknowledge] = []

    async def look(user: Any) -> None:
        shown[-1].show(safety_status(STOPPED, 0.0))
        assert shown[-1]._press.first.enabled is not bool(refusal)
        if refusal:
            await user.should_see(refusal)

    simulated(lambda: shown.append(_Acknowledge(viewer, "safety")), look)
