"""How long blocks of samples are: what launch files say is what the register chooses."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import pytest

from nodes.emg import EmgParams
from nodes.rig_torque import RigTorque, RigTorqueParams
from nodes.stage import Stage, StageParams
from palp_core import Bench
from palp_core.graph.description.file_reader import read
from palp_core.methods import choose, methods
from palp_core.palpation.devices.blocks import (
    LENGTHS,
    LONGEST_S,
    WANTED,
    Stream,
    block_mistakes,
    late_blocks,
)
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.session.block_measures import longest_wait_s, measure_blocks

ROOT = Path(__file__).resolve().parents[3]
LENGTH = {one.name: one for one in LENGTHS}


def chosen(stream: Stream, rate_hz: float, *, wall_clock: bool) -> int:
    """Return the samples of a block that the register chooses for a stream."""
    wanted = WANTED[stream]
    scene = {"sample_hz": rate_hz, "wall_clock": float(wall_clock)}
    return LENGTH[choose("block", wanted.output, wanted.age_s, scene).name].samples(rate_hz)


def params(launch: str, node: str, defaults: Any, *overrides: str) -> Any:
    """Return the parameters that a node has in a launch file, those of its class among them."""
    drafts = read(ROOT / "launch" / launch, overrides).nodes[node]
    stated = next(draft for draft in drafts if draft.present).spec.params
    fields = defaults.__struct_fields__
    return {name: stated.get(name, getattr(defaults, name)) for name in fields}


@pytest.mark.parametrize(
    ("reading", "stream", "samples"), [("feature", "sweep", 1000), ("trace", "torque", 50)]
)
def test_simulated_torque_comes_in_the_blocks_that_the_register_chooses(
    reading: str, stream: Stream, samples: int
) -> None:
    """For a feature nobody acts upon torque before a sweep is over; a trace is decided within."""
    found = params("sim.yaml", "stage", StageParams(), f"reading:={reading}")
    assert StageParams(within_sweep=found["within_sweep"]).stream == stream
    assert found["block_samples"] == chosen(stream, found["rate_hz"], wall_clock=False) == samples


@pytest.mark.parametrize("launch", ["rig.yaml", "emulated.yaml"])
def test_the_rigs_torque_and_loads_come_in_the_blocks_that_the_register_chooses(launch: str) -> None:
    found = params(launch, "torque", RigTorqueParams())
    assert found["block_samples"] == chosen("torque", found["rate_hz"], wall_clock=True) == 20
    assert chosen("load", found["load_hz"], wall_clock=True) == 1


@pytest.mark.parametrize("launch", ["sim.yaml", "rig.yaml", "emulated.yaml"])
def test_emg_comes_in_the_blocks_that_the_register_chooses(launch: str) -> None:
    found = params(launch, "emg", EmgParams())
    assert found["block_samples"] == chosen("emg", found["rate_hz"], wall_clock=launch != "sim.yaml") == 75


@pytest.mark.parametrize("stream", list(WANTED))
@pytest.mark.parametrize("wall_clock", [True, False])
def test_what_a_node_calls_late_is_what_the_register_refuses(stream: Stream, wall_clock: bool) -> None:
    wanted = WANTED[stream]
    scene = {"sample_hz": 1000.0, "wall_clock": float(wall_clock)}
    for one in (one for one in methods("block") if not one.reference):
        bound = one.bound(wanted.output, scene)
        late = late_blocks(stream, LENGTH[one.name].length_s, wall_clock=wall_clock)
        if wall_clock or wanted.output == "age_s":
            assert (bound is None or bound > wanted.age_s) == bool(late), one.name


@pytest.mark.parametrize("length", LENGTHS, ids=lambda one: one.name)
def test_no_sweep_waits_longer_for_its_last_block_than_is_stated(length: Any) -> None:
    samples = length.samples(1000.0)
    waits_s = longest_wait_s(samples, 0.3)
    assert waits_s == pytest.approx((samples - 1) * 1e-3, abs=1e-9)
    assert waits_s <= length.length_s


@pytest.mark.parametrize("rate_hz", [30.0, 535.447, 932.857, 1000.0, 1500.0, 17871.2])
def test_no_block_is_longer_than_its_length_says_at_any_rate(rate_hz: float) -> None:
    for one in methods("block"):
        if not one.reference and not one.strayed({"sample_hz": rate_hz}):
            assert LENGTH[one.name].samples(rate_hz) / rate_hz <= LENGTH[one.name].length_s * (1.0 + 1e-9)


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
    assert "0.05 s are wanted; see: palp methods block" in caplog.text


def test_each_length_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palp_core.palpation.session.block_measures.cpu_s", lambda *_, **__: 1.0)
    found = list(measure_blocks(Scene()))
    assert [one.method for one in found] == [*LENGTH, "sweep"]
    late = [one.method for one in found if one.fails]
    assert late == ["1s", "50ms", "sweep"]  # on the rig
    for one in found[:-1]:
        assert one.error == pytest.approx(LENGTH[one.method].length_s)
