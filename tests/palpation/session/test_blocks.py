"""How long blocks of samples are: no launch file's are late for their reader."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import pytest

from nodes.emg import EmgParams
from nodes.rig_torque import RigTorque, RigTorqueParams
from nodes.stage import Stage, StageParams
from palp_core import Bench
from palp_core.graph.description.resolver import resolve
from palp_core.palpation.devices.blocks import (
    LONGEST_S,
    Stream,
    block_mistakes,
    late_blocks,
)

ROOT = Path(__file__).resolve().parents[3]


def params(launch: str, node: str, defaults: Any, *overrides: str) -> Any:
    """Return the parameters that a node has in a launch file, those of its class among them."""
    stated = resolve(ROOT / "launch" / launch, overrides).nodes[node].spec.params
    fields = defaults.__struct_fields__
    return {name: stated.get(name, getattr(defaults, name)) for name in fields}


@pytest.mark.parametrize(
    ("reading", "stream", "samples"), [("feature", "sweep", 1000), ("trace", "torque", 50)]
)
def test_simulated_torque_comes_in_blocks_that_are_not_late(
    reading: str, stream: Stream, samples: int
) -> None:
    """For a feature nobody acts upon torque before a sweep is over; a trace is decided within."""
    found = params("sim.yaml", "stage", StageParams(), f"reading:={reading}")
    assert StageParams(within_sweep=found["within_sweep"]).stream == stream
    assert found["block_samples"] == samples
    assert not late_blocks(stream, samples / found["rate_hz"], wall_clock=False)


@pytest.mark.parametrize("launch", ["rig.yaml", "emulated.yaml"])
def test_the_rigs_torque_and_loads_come_in_blocks_that_are_not_late(launch: str) -> None:
    found = params(launch, "torque", RigTorqueParams())
    assert found["block_samples"] == 20
    assert not late_blocks("torque", 20 / found["rate_hz"], wall_clock=True)
    assert not late_blocks("load", 1.0 / found["load_hz"], wall_clock=True)


@pytest.mark.parametrize("launch", ["sim.yaml", "rig.yaml", "emulated.yaml"])
def test_emg_comes_in_blocks_that_are_not_late(launch: str) -> None:
    found = params(launch, "emg", EmgParams())
    assert found["block_samples"] == 75
    assert not late_blocks("emg", 75 / found["rate_hz"], wall_clock=launch != "sim.yaml")


def test_blocks_of_more_than_a_second_are_refused_in_words() -> None:
    assert block_mistakes(1000, 1000.0) == {}
    said = block_mistakes(1500, 1000.0)["block_samples"]
    assert said.startswith("a block of 1500 samples at 1000 Hz lasts 1.5 s")
    assert f"give {1000 * LONGEST_S:g} at most" in said
    assert "block_samples" in RigTorque.examine(RigTorqueParams(block_samples=1001))
    assert "block_samples" in Stage.examine(StageParams(block_samples=1001))


def test_blocks_that_are_late_for_their_reader_are_said_at_the_start(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.WARNING):
        Bench(Stage, {"block_samples": 50})
        assert not caplog.records
        Bench(Stage, {"block_samples": 100})
    assert "the torque comes in blocks of 0.1 s" in caplog.text
    assert "0.05 s are wanted" in caplog.text
