"""What is shown of safety and of the scene."""

from __future__ import annotations

import math

import pytest

from palp_core.graph.discovery.troubles import Trouble
from palp_core.graph.messages.topic import Topic
from palp_core.palpation.live_page.monitor import path_of, topics_by_type
from palp_core.palpation.live_page.safety import heading, safety_status
from palp_core.palpation.mechanics.probe import Probe
from palp_core.view.source.overview import WireState

pytest.importorskip("nicegui")

from palp_core.palpation.live_page.drawing.panels import lean_rad, lengths_mm

BEAT = {"state": "ready", "permits": True, "cause": "", "text": "", "warning": ""}


def test_a_tripped_safety_node_says_why_and_what_to_do() -> None:
    now = safety_status({**BEAT, "state": "latched", "cause": "torque", "text": "105 N mm"}, 0.0)
    assert (now.word, now.level, now.tripped) == ("STOPPED", "error", True)
    assert now.why == "torque: 105 N mm"
    assert "palp safety ack" in now.advice


def test_a_stop_that_somebody_asked_for_is_shown_once_and_not_as_something_wrong() -> None:
    now = safety_status({**BEAT, "state": "latched", "cause": "operator", "text": "palp view"}, 0.0)
    assert now.why == "nothing moves, all nodes go on; on request: palp view"
    assert "palp safety ack" in now.advice
    other = Trouble("/stage", "error", "it is broken")
    stopped = Trouble("/safety", "error", "tripped: operator: palp view", "palp safety ack")
    assert heading([stopped, other]) == ("stopped on purpose", [other])
    assert heading([Trouble("/safety", "error", "tripped: torque: 105 N mm")]) is None


@pytest.mark.parametrize(
    ("beat", "silent_s", "level"),
    [
        (None, 0.0, "unknown"),
        (BEAT, 0.0, "ok"),
        ({**BEAT, "warning": "one link only"}, 0.0, "warn"),
        ({**BEAT, "state": "starting"}, 0.0, "warn"),
        (BEAT, 3.0, "error"),
        ({"state": "moving", "permits": True, "cause": "", "text": ""}, 0.0, "ok"),
    ],
)
def test_how_bad_it_is_shows(beat: dict[str, object] | None, silent_s: float, level: str) -> None:
    assert safety_status(beat, silent_s).level == level


def test_the_drawing_is_the_probes_own_size() -> None:
    size = lengths_mm(-0.03, 0.05)
    assert (size["base"], size["tip"], size["slab"], size["to"]) == (80.0, 70.0, 30.0, 50.0)


def test_the_tip_leans_with_the_torque_until_it_leaves_the_gel() -> None:
    probe = Probe()
    small = lean_rad(0.01, 0.016)
    held = probe.spring_n_m(0.016) + probe.weight_n_m
    assert math.sin(small) * held * (probe.base_m + probe.lever_m) == pytest.approx(0.01 * probe.lever_m)
    assert lean_rad(-0.01, 0.016) == -small
    farthest = lean_rad(1.0, 0.0)
    assert probe.lever_m * (1 - math.cos(farthest)) == pytest.approx(0.004)


def test_the_path_is_the_launch_files() -> None:
    assert path_of({}) == (-0.03, 0.05)
    assert path_of({"params": {"stage": {"from_m": 0.05, "to_m": "x"}}}) == (0.05, 0.05)


def test_of_two_topics_of_a_type_the_one_that_the_experiment_hears_is_meant() -> None:
    def topic(name: str, kind: str) -> Topic:
        return Topic(name=name, type=kind, node=name.split("/")[1])

    topics = [
        topic("/shadow/belief", "Belief"),
        topic("/estimator/belief", "Belief"),
        topic("/exp/result", "TrialResult"),
    ]
    wires = [
        WireState(topic="/shadow/belief", source="shadow", reader="policy"),
        WireState(topic="/estimator/belief", source="estimator", reader="exp"),
    ]
    assert topics_by_type(topics, wires)["Belief"] == "/estimator/belief"
    assert topics_by_type(topics)["Belief"] == "/shadow/belief"
