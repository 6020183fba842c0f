"""A stage of another maker is one file and one published name; the nodes know no maker."""

from __future__ import annotations

import msgspec
import pytest

from msgs.safety import StopRequest
from msgs.stage import SweepGoal
from nodes.rig_stage import RigStage
from nodes.safety import Safety, SafetyParams
from palp_core import Bench
from palp_core.cli.rig import device_discovery
from palp_core.cli.rig.device_discovery import device_entries, discover
from palp_core.errors import DeviceError, GraphError, NodeError
from palp_core.palpation.devices import registry
from palp_core.palpation.devices.protocols import restored
from palp_core.palpation.devices.registry import open_device
from palp_core.published import published
from tests.support import made_up_stage
from tests.support.kept import replace
from tests.support.made_up_stage import MadeUpStage, MadeUpState, MadeUpStop
from tests.support.permitted import PermittedBench

OWN_LINK = {"device": "made_up", "options": {"port": 7}, "stop_link": "port 8", "watch_processes": False}
GOAL = SweepGoal(stamp_ns=0, goal_id=1, from_m=-0.002, to_m=0.002)


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Publish its name."""
    place = {"stage.made_up": "tests.support.made_up_stage:MadeUpStage"}
    for module in (registry, device_discovery):
        monkeypatch.setattr(module, "published", lambda group: {**published(group), **place})
    MadeUpStop.written.clear()


def permitted() -> PermittedBench:
    bench = Bench(RigStage, {"device": "made_up", "options": {"port": 7}})
    return PermittedBench(bench, bench.node.device)


def test_the_stage_node_sweeps_with_it() -> None:
    stage = permitted()
    bench = stage.bench
    assert isinstance(stage.device, MadeUpStage)
    stage.run(0.1)
    bench.feed(RigStage.goal, GOAL)
    stage.run(2.0)
    words = [status.status for status in bench.sent(RigStage.status)]
    assert words == ["ready", "sweeping", "swept", "ready"]
    swept = next(status for status in bench.sent(RigStage.status) if status.status == "swept")
    assert (swept.leave_ns - swept.enter_ns) * 1e-9 == pytest.approx(0.2, abs=2e-3)  # 4 mm at 20 mm/s
    places_m = [place for pose in bench.sent(RigStage.pose) for place in pose.position_m]
    assert places_m[0] == pytest.approx(-0.002, abs=1e-4)
    report = bench.sent(RigStage.report)[-1]
    assert report.condition == "ok"
    assert report.z_m == pytest.approx(0.020)
    assert not report.moving


def test_a_replacement_takes_over_what_it_remembers() -> None:
    stage = permitted()
    stage.run(0.1)
    stage.bench.node.memory.z_m = 0.007
    remembered = replace(stage.bench).node.memory
    assert isinstance(remembered, MadeUpState)
    assert remembered.z_m == 0.007


def test_the_safety_node_stops_it_on_its_own_link() -> None:
    bench = Bench(Safety, OWN_LINK)
    assert bench.call(Safety.stop, StopRequest()).state == "latched"
    assert MadeUpStop.written == ["open port 8", "abort", "disable"]


@pytest.mark.parametrize(
    ("device", "link", "guilty", "shown"),
    [
        ("sim", "port 8", "stop_link", "has no second link to its controller; give stop_link: none"),
        ("mad_up", "port 8", "device", "no stage device 'mad_up'"),
        ("made_up", "", "stop_link", "is empty; give the address of the stage's second link, or none"),
        ("sim", "none", "", ""),
        ("made_up", "none", "", ""),
    ],
)
def test_a_stop_link_is_the_drivers_own_or_none_and_is_always_given(
    device: str, link: str, guilty: str, shown: str
) -> None:
    assert shown in Safety.examine(SafetyParams(device=device, stop_link=link)).get(guilty, "")
    assert bool(Safety.examine(SafetyParams(device=device, stop_link=link))) == bool(guilty)


@pytest.mark.parametrize("missing", ["device", "stop_link"])
def test_the_safety_node_guesses_neither_the_stages_driver_nor_that_there_is_no_link(missing: str) -> None:
    given = {name: value for name, value in OWN_LINK.items() if name != missing}
    with pytest.raises(GraphError, match=f"{missing} is missing"):
        Bench(Safety, given)


def test_a_second_link_that_lacks_an_ability_is_refused_before_it_is_needed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delattr(MadeUpStop, "finish_stop")
    monkeypatch.delattr(MadeUpStop, "abort")
    with pytest.raises(NodeError, match="MadeUpStop has no abort, no finish_stop; see palp_core"):
        Bench(Safety, OWN_LINK)


def test_a_driver_that_takes_not_all_that_a_stage_is_handed_is_refused_at_once() -> None:
    class Short(MadeUpStage):
        def __init__(self, port: int, lift_m: float) -> None: ...

    vars(made_up_stage)["Short"] = Short
    name = "tests.support.made_up_stage:Short"
    with pytest.raises(DeviceError, match="Short takes no limits, no sweep_speed_m_per_s, no lift_speed_m_"):
        open_device("stage", name, port=7, lift_m=0.01)


def test_the_command_line_lists_and_finds_it() -> None:
    (entry,) = [entry for entry in device_entries() if entry.name == "made_up"]
    assert (entry.kind, entry.link, entry.options["port"]) == ("stage", "made up", "")
    assert discover("made_up", {"port": 7}, 1.0) == {"controller": "answers on port 7"}
    with pytest.raises(DeviceError, match="made_up: where is it\\? give port:=7"):
        discover("made_up", {}, 1.0)


@pytest.mark.parametrize(
    ("kind", "name", "misspelt"), [("stage", "sim", "retreat"), ("ring", "sim", "rehome")]
)
def test_an_ability_that_is_missing_is_refused_by_name(
    monkeypatch: pytest.MonkeyPatch, kind: str, name: str, misspelt: str
) -> None:
    made = type(open_device(kind, name))  # type: ignore[call-overload]
    monkeypatch.setattr(made, f"{misspelt}_", getattr(made, misspelt), raising=False)
    monkeypatch.delattr(made, misspelt)
    with pytest.raises(DeviceError, match=rf"{kind} device .sim.: {made.__name__} has no {misspelt};"):
        open_device(kind, name)  # type: ignore[call-overload]


def test_a_state_comes_back_from_what_was_kept_of_it() -> None:
    stage, state = MadeUpStage(7), MadeUpState(open_count=3)
    assert restored(stage, state) is state
    assert restored(stage, msgspec.to_builtins(state)) == state
    assert restored(stage, None) == MadeUpState()


@pytest.mark.parametrize(
    "kept",
    [
        {"homed": True},
        {**msgspec.to_builtins(MadeUpState()), "homed": True},
        {"open_count": 3},
        {**msgspec.to_builtins(MadeUpState()), "start_ns": "soon"},
        7,
    ],
)
def test_what_another_device_remembered_is_no_state_of_it(kept: object) -> None:
    with pytest.raises(DeviceError, match="MadeUpStage remembers MadeUpState, and what was handed over is"):
        restored(MadeUpStage(7), kept)


def test_a_stage_class_that_says_nothing_of_a_second_link_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(MadeUpStage, "stop_link")
    found = Safety.examine(SafetyParams(device="made_up", stop_link="port 8"))
    assert "give stop_link: none" in found["stop_link"]
