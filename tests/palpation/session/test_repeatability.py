"""The plan ``repeatability``: what the simulated rig was given comes back within intervals, and is loaded."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from nodes.actuator import Actuator
from nodes.experiment_plan import ExperimentParams, design_of
from nodes.phantom import Phantom
from nodes.torque import Torque
from palp_core import Bench
from palp_core.errors import PalpError, PerceptionError
from palp_core.palpation.perception.belief.rig_noise import Component, RigNoise, read_noise, write_noise
from palp_core.palpation.perception.statistics.variance_components import Block, estimate
from palp_core.palpation.session.plan import BeginTrial, MountPhantom, Palpate, Rehome, StepReply, Wait
from palp_core.palpation.session.plan_repeatability import RepeatDesign, repeatability, sweep_count
from palp_core.palpation.session.recorded_sweeps import RecordedSweeps, read_sweeps
from palp_core.palpation.session.repeatability import measure_repeatability
from tests.support.rig_session import ComposedGraph

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("repeat") / "out"
    with ComposedGraph(
        str(ROOT / "launch" / "sim.yaml"),
        plan="repeatability",
        overrides=["shared.ring_error:=normal"],
        out=str(out),
    ) as graph:
        graph.run()
    return out


def test_the_rig_repeats_itself_as_the_simulation_was_set(rig: Path) -> None:
    noise = read_noise(rig / "noise.yaml")
    for component, truth in ((noise.ring_sd_m, 0.15e-3), (noise.height_sd_m, 0.1e-3)):
        assert component.low is not None
        assert component.high is not None
        assert component.low <= truth <= component.high
    assert noise.sample_sd_n_m.value == pytest.approx(1e-3 / 64, rel=0.03)
    assert noise.hour_sd_n_m.value < 1e-5
    assert {"noise.yaml", "report.html", "result.json"} <= {p.name for p in rig.iterdir()}


def test_the_record_has_a_row_per_sweep_of_the_plan_and_one_that_ended_early_says_so(rig: Path) -> None:
    stored, design = read_sweeps(rig), RepeatDesign("A")
    assert len(stored.sweeps) == sweep_count(design)
    assert {s.remount for s in stored.phase("remount")} == set(range(1, design.remounts + 1))
    assert len(stored.phase("stay")) == design.stay * len(design.rings_m)
    with pytest.raises(PalpError, match="re-positioned"):
        measure_repeatability(RecordedSweeps(rig, stored.sweeps[:10]))
    with pytest.raises(PalpError, match="plan:=repeatability"):
        measure_repeatability(RecordedSweeps(rig, ()))


def test_simulated_devices_load_the_noise_file(tmp_path: Path) -> None:
    path = tmp_path / "noise.yaml"
    sample, sweep, ring_m, height = (Component(sd) for sd in (3e-5, 1e-6, 4e-4, 7e-4))
    write_noise(
        RigNoise(sample_sd_n_m=sample, sweep_sd_n_m=sweep, ring_sd_m=ring_m, height_sd_m=height), path
    )
    ring = Bench(Actuator, {"noise": str(path)}).node.device
    assert (ring.distribution, ring.repeatability_m) == ("normal", pytest.approx(8e-4))  # type: ignore[attr-defined]
    assert Bench(Phantom, {"noise": str(path)}).node.height_sd_m == 7e-4
    assert Bench(Torque, {"noise": str(path)}).node.device.noise_sd_n_m == 3e-5  # type: ignore[attr-defined]


def test_a_file_of_bare_gel_is_swept_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "bare.yaml"
    path.write_text("gel: {modulus_pa: 15000.0, bead: none}\n")
    design = design_of(ExperimentParams(plan="repeatability", phantoms=str(path), wait_s=5.0))
    assert isinstance(design, RepeatDesign)
    assert (design.phantom, design.wait_s) == ("gel", 5.0)
    assert design_of(ExperimentParams(plan="repeatability")) == RepeatDesign("A")


def test_the_plan_moves_only_what_each_condition_is_about() -> None:
    design = RepeatDesign(
        "A", rings_m=(0.008, 0.016), stay=3, repositions=2, remounts=2, hours=1, wait_s=60.0
    )
    steps, plan = [], repeatability(design)
    step = next(plan, None)
    while step is not None:
        steps.append(step)
        try:
            step = plan.send(StepReply())
        except StopIteration:
            step = None
    assert sum(isinstance(s, Palpate) for s in steps) == sweep_count(design)
    assert [s.index for s in steps if isinstance(s, BeginTrial)] == list(range(10))
    before = {
        trial.phase: tuple(
            type(s) for s in itertools.takewhile(lambda s: not isinstance(s, Palpate), steps[i::-1])
        )
        for i, trial in enumerate(steps)
        if isinstance(trial, BeginTrial)
    }
    assert before == {
        "stay": (BeginTrial, Rehome),
        "reposition": (BeginTrial, Rehome),
        "remount": (BeginTrial, MountPhantom),
        "hour": (BeginTrial, Wait),
    }


def test_a_failed_sweep_is_repeated_and_another_word_is_refused() -> None:
    plan = repeatability(RepeatDesign("A"))
    step = next(plan)
    while not isinstance(step, Palpate):
        step = plan.send(StepReply())
    assert plan.send(StepReply("failed")) == step
    with pytest.raises(PerceptionError, match="decided"):
        plan.send(StepReply("decided"))


@pytest.mark.parametrize(
    "numbers", [{"rings_m": (0.004,)}, {"stay": 1}, {"group": 1}, {"remounts": 1}, {"wait_s": -1.0}]
)
def test_a_plan_that_could_measure_nothing_is_refused(numbers: dict[str, object]) -> None:
    with pytest.raises(PerceptionError, match="repeatability"):
        RepeatDesign("A", **numbers)  # type: ignore[arg-type]


def blocks(rng: np.random.Generator, ring: float, height: float) -> list[Block]:
    found = [Block("", 0.0, (rng.normal(0.0, 1e-5, 8),))]
    for slope in (0.5, 1.0, 2.0):
        groups = (slope * ring * rng.normal() + rng.normal(0.0, 1e-5, 2) for _ in range(10))
        found.append(Block("ring", slope, tuple(groups)))
    groups = (2.0 * height * rng.normal() + rng.normal(0.0, 1e-5, 2) for _ in range(16))
    return [*found, Block("height", 2.0, tuple(groups))]


@pytest.mark.slow
def test_intervals_of_the_components_hold_the_truth() -> None:
    rng, inside = np.random.default_rng(1), []
    for _ in range(12):
        found = estimate(blocks(rng, 1e-4, 5e-5))
        for name, truth in (("", 1e-5), ("ring", 1e-4), ("height", 5e-5)):
            assert found[name].low <= found[name].value <= found[name].high
            inside.append(found[name].low <= truth <= found[name].high)
    assert np.mean(inside) >= 0.85


def test_components_scale_with_the_readings_and_a_cause_that_does_nothing_reaches_down_to_nothing() -> None:
    plain = blocks(np.random.default_rng(3), 1e-4, 0.0)
    found = estimate(plain)
    scaled = estimate([Block(b.cause, b.slope, tuple(7.0 * g for g in b.groups)) for b in plain])
    for name, one in found.items():
        assert scaled[name].value == pytest.approx(7.0 * one.value, rel=1e-3, abs=1e-9)
        assert scaled[name].high == pytest.approx(7.0 * one.high, rel=1e-3)
    assert found["height"].low == 0.0
    assert found["height"].high < 1e-5


@pytest.mark.parametrize(
    ("bad", "match"),
    [
        ([Block("", 0.0, (np.ones(1),))], "two readings"),
        ([Block("", 0.0, (np.array([np.nan, 1.0]),))], "NaN"),
        ([Block("ring", 0.0, (np.ones(2), np.ones(2)))], "ring"),
        ([Block("ring", 1.0, (np.arange(2.0),))], "ring"),
    ],
)
def test_readings_without_information_are_refused(bad: list[Block], match: str) -> None:
    with pytest.raises(PerceptionError, match=match):
        estimate(bad)
