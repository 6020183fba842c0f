"""Names of devices, and what the simulated ones promise."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from palp_core.errors import DeviceError
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.devices import (
    EmgDevice,
    RingDevice,
    StageDevice,
    TorqueSensor,
    known_devices,
    open_device,
    registry,
)
from palp_core.palpation.devices.emg.lsl import LslEmg
from palp_core.palpation.devices.emg.noraxon import NoraxonEmg
from palp_core.palpation.devices.limits import TravelLimits
from palp_core.palpation.devices.registry import find_device_mistakes
from palp_core.palpation.devices.ring.maestro import MaestroRing
from palp_core.palpation.devices.sim.emg import SimEmg
from palp_core.palpation.devices.sim.ring import SimRing
from palp_core.palpation.devices.sim.stage import SimStage
from palp_core.palpation.devices.sim.torque import SimTorque
from palp_core.palpation.devices.stage.aerotech import AerotechStage
from palp_core.palpation.devices.torque.ati import AtiTorque

CHAIN = [[0.2] * 5] * 5


def test_the_devices_satisfy_the_protocols_and_are_known_by_name() -> None:
    """Type checkers look at these lines; the contract is run on each of them elsewhere."""
    stages: list[StageDevice[Any]] = [SimStage(), AerotechStage("socket://127.0.0.1:1")]
    rings: list[RingDevice[Any]] = [SimRing(), MaestroRing("/nowhere")]
    torques: list[TorqueSensor[Any]] = [SimTorque(), AtiTorque()]
    emg: list[EmgDevice[Any]] = [SimEmg(matrix=CHAIN), NoraxonEmg("127.0.0.1"), LslEmg("nothing")]
    names = [known_devices(kind) for kind in ("stage", "ring", "torque", "emg")]
    assert names == [["aerotech", "sim"], ["maestro", "sim"], ["ati", "sim"], ["lsl", "noraxon", "sim"]]
    assert [len(known) for known in names] == [len(made) for made in (stages, rings, torques, emg)]


@pytest.mark.parametrize(
    ("kind", "options", "expected"),
    [
        ("stage", {"sweep_speed_m_per_s": 0.01}, SimStage(sweep_speed_m_per_s=0.01)),
        ("ring", {"distribution": "normal"}, SimRing(distribution="normal")),
        ("torque", {}, SimTorque()),
        ("emg", {"matrix": np.array(CHAIN)}, SimEmg(matrix=CHAIN)),
    ],
)
def test_a_name_is_for_a_class_and_passes_the_options_on(
    kind: Any, options: dict[str, Any], expected: object
) -> None:
    assert "sim" in known_devices(kind)
    assert open_device(kind, "sim", **options) == expected


@pytest.mark.parametrize(
    ("kind", "name", "options", "says"),
    [
        ("torque", "nano71", {}, "known: ati, sim"),
        ("gripper", "sim", {}, "known: emg, ring, stage, torque"),
        ("ring", "sim", {"sped_m_per_s": 1.0}, "its options are speed_m_per_s"),
        ("emg", "sim", {}, "missing a required argument: 'matrix'"),
        ("torque", "ati", {"interface": True}, "interface = True: it must be a text, not true or false"),
        ("torque", "ati", {"verified": [0.5]}, "must be a text, not a number"),
        ("torque", "ati", {"rate_hz": "fast"}, "rate_hz = 'fast': it must be a number, not a text"),
        ("stage", "aerotech", {"url": "x", "limits": {"y_m": [0.02, -0.02]}}, "y_m high = -0.02 must lie in"),
        ("ring", "palp_core.nowhere:Ring", {}, "cannot import"),
        ("ring", "palp_core.palpation.devices.sim.ring:Rong", {}, "cannot import"),
        (
            "ring",
            "tests.support.broken_driver:Ring",
            {},
            "'tests.support.broken_driver:Ring': ZeroDivisionError: division",
        ),
    ],
)
def test_an_unknown_name_or_option_lists_what_there_is(
    kind: Any, name: str, options: dict[str, Any], says: str
) -> None:
    with pytest.raises(DeviceError, match=says):
        open_device(kind, name, **options)


def test_an_installation_without_devices_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "published", lambda group: {})
    with pytest.raises(DeviceError, match="install palp-core again"):
        registry.back_end("torque", "ati")


@pytest.mark.parametrize(
    ("kind", "name", "options", "guilty"),
    [
        ("torque", "nano71", {}, {"device": "no torque device 'nano71'; known: ati, sim, or give"}),
        ("ring", "maestro", {"url": "x", "speed_m_per_s": 1.0}, {"options": "speed_m_per_s = 1 must lie in"}),
        ("stage", "aerotech", {"url": "socket://127.0.0.1:1"}, {}),
        ("emg", "lsl", {"stream": "arm", "rate_hz": 1500.0}, {}),
    ],
)
def test_mistakes_are_found_by_the_nodes_parameter_without_opening_a_device(
    kind: Any, name: str, options: dict[str, Any], guilty: dict[str, str]
) -> None:
    found = Mistakes()
    find_device_mistakes(kind, name, options, found)
    assert list(found) == list(guilty)
    assert all(text in found[parameter] for parameter, text in guilty.items())


@pytest.mark.parametrize(
    ("kind", "name", "options", "expected"),
    [
        ("torque", "ati", {"channel": 0}, {"channel": 0}),  # python-can's own: a number or a name
        ("torque", "ati", {"channel": "0"}, {"channel": "0"}),
        ("emg", "noraxon", {"host": 1}, {"host": "1"}),
        ("emg", "lsl", {"stream": 7}, {"stream": "7"}),
        ("stage", "aerotech", {"url": "x", "axes": [0, 1]}, {"axes": ("0", "1")}),
        ("stage", "aerotech", {"url": "x", "axes": ["X", 1]}, {"axes": ("X", "1")}),
    ],
)
def test_digits_are_a_text_where_an_option_is_one(
    kind: Any, name: str, options: dict[str, Any], expected: dict[str, Any]
) -> None:
    made = open_device(kind, name, **options)
    assert {option: getattr(made, option) for option in expected} == expected


def test_options_are_what_a_yaml_file_can_say() -> None:
    options = {"url": "x", "axes": ["A", "B"], "limits": {"y_m": [-0.01, 0.02]}, "sweep_speed_m_per_s": 0.01}
    stage: object = open_device("stage", "aerotech", **options)
    limits = TravelLimits(y_m=(-0.01, 0.02))
    assert stage == AerotechStage("x", axes=("A", "B"), limits=limits, sweep_speed_m_per_s=0.01)


@pytest.mark.parametrize("device", [SimStage(), SimRing(), SimTorque(), SimEmg(matrix=CHAIN)])
def test_every_parameter_refuses_nan(device: Any) -> None:
    for field in dataclasses.fields(device):
        if isinstance(getattr(device, field.name), float):
            with pytest.raises(DeviceError, match=field.name):
                dataclasses.replace(device, **{field.name: float("nan")})
