"""How long blocks of samples are: no launch file's are late for their reader, and late ones are reported."""

from __future__ import annotations

import logging
from typing import Any

import pytest

from nodes.emg import EmgParams
from nodes.rig_stage import RigStage
from nodes.rig_torque import RigTorque, RigTorqueParams
from nodes.stage import Stage, StageParams
from palp_core import Bench
from palp_core.errors import DeviceError
from palp_core.graph.description.resolver import resolve
from palp_core.palpation.devices.blocks import LONGEST_S, Stream, check_block, late_blocks
from tests.support.palp import ROOT


@pytest.mark.parametrize(
    ("launch", "node", "defaults", "stream", "samples"),
    [
        ("sim.yaml reading:=feature", "stage", StageParams(), "sweep", 1000),  # acted upon when it is over
        ("sim.yaml reading:=trace", "stage", StageParams(), "torque", 50),  # decided within
        ("rig.yaml", "torque", RigTorqueParams(), "torque", 20),
        ("emulated.yaml", "torque", RigTorqueParams(), "torque", 20),
        ("sim.yaml", "emg", EmgParams(), "emg", 150),
        ("rig.yaml", "emg", EmgParams(), "emg", 75),
        ("emulated.yaml", "emg", EmgParams(), "emg", 75),
    ],
)
def test_no_block_is_late_for_its_reader(
    launch: str, node: str, defaults: Any, stream: Stream, samples: int
) -> None:
    file, *overrides = launch.split()
    stated = resolve(ROOT / "launch" / file, overrides).nodes[node].spec.params
    found = {name: stated.get(name, getattr(defaults, name)) for name in defaults.__struct_fields__}
    wall = file != "sim.yaml"
    assert found["block_samples"] == samples
    assert not late_blocks(stream, samples / found["rate_hz"], wall_clock=wall)
    if "load_hz" in found:
        assert not late_blocks("load", 1.0 / found["load_hz"], wall_clock=wall)
    if node == "stage":
        assert StageParams(within_sweep=found["within_sweep"]).stream == stream


def test_blocks_of_more_than_a_second_are_refused_in_words() -> None:
    check_block(1000, 1000.0)
    text = f"a block of 1500 samples at 1000 Hz lasts 1.5 s, .* give {1000 * LONGEST_S:g} at most"
    with pytest.raises(DeviceError, match=text):
        check_block(1500, 1000.0)
    assert "block_samples" in RigTorque.examine(RigTorqueParams(block_samples=1001))
    assert "block_samples" in Stage.examine(StageParams(block_samples=1001))


def test_blocks_that_are_late_for_their_reader_are_reported_at_the_start(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.WARNING):
        Bench(Stage, {"block_samples": 50})
        Bench(RigStage, {"device": "sim", "block_samples": 100})  # a sensor of its own streams the torque
        assert not caplog.records
        Bench(Stage, {"block_samples": 100})
    assert "the torque comes in blocks of 0.1 s" in caplog.text
    assert "0.05 s are wanted" in caplog.text
    assert late_blocks("load", 1 / 345, wall_clock=True) == ""
    assert late_blocks("load", 1 / 344, wall_clock=True) != ""
