"""``palp launch --check`` says what of the parameters no method guarantees, and what to do about it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from palp_core.graph.launch.checking import check_start
from palp_core.graph.launch.summary import RunSummary, summary_of
from palp_core.palpation.session.methods.advice import advice
from tests.support.palp import SIM
from tests.support.rig_session import check_here

RUNS = [SIM, SIM.with_name("emulated.yaml")]


@pytest.fixture(scope="module")
def runs() -> list[RunSummary]:
    return [summary_of(check_here(path), path) for path in RUNS]


def changed(run: RunSummary, node: str, **params: Any) -> RunSummary:
    return msgspec.structs.replace(run, params=run.params | {node: run.params[node] | params})


def test_the_launch_files_of_palp_need_no_advice(runs: list[RunSummary]) -> None:
    for run in runs:
        assert advice(run) == []


def test_a_stage_that_is_faster_than_the_computed_touch_is_bounded_for_is_told_how_fast_it_may_be(
    runs: list[RunSummary],
) -> None:
    for run in runs:
        assert advice(changed(run, "stage", sweep_speed_m_s=0.05)) == []
        (words,) = advice(changed(run, "stage", sweep_speed_m_s=0.08))
        assert words.startswith("/stage: sweep_speed_m_s: 0.08: inertia: quasi_static")
        assert words.endswith("sweep at 0.05 m/s or slower")
    finer = changed(changed(runs[0], "phantom", tolerance=0.01), "stage", sweep_speed_m_s=0.03)
    assert advice(finer)[0].endswith("sweep at 0.02 m/s or slower")


def test_samples_that_come_later_than_asked_are_told_how_long_blocks_may_be(runs: list[RunSummary]) -> None:
    sim, emulated = runs
    assert sim.params["stage"]["block_samples"] > 50  # of a feature nothing is acted upon within a sweep
    (words,) = advice(changed(sim, "stage", block_samples=51, within_sweep=True))
    assert words.startswith("/stage: block_samples: 51: the torque comes in blocks of 0.051 s")
    assert words.endswith("give 50 at most, at 1000 Hz")
    (words,) = advice(changed(emulated, "torque", block_samples=41))
    assert words.endswith("give 40 at most, at 1000 Hz")
    (words,) = advice(changed(emulated, "emg", block_samples=150))
    assert words.startswith("/emg: block_samples: 150: the emg comes in blocks of 0.1 s")
    (words,) = advice(changed(emulated, "torque", load_hz=100.0))
    assert words.endswith("give 345 at least")


def test_a_policy_that_is_to_take_over_in_a_trial_that_there_will_not_be_is_named(
    runs: list[RunSummary],
) -> None:
    sim, late = runs[0], "12=nodes.policy_markov:Markov, 300=nodes.policy_uniform:Uniform"
    (words,) = advice(changed(sim, "experiment", trials=4, swaps=late))
    assert words == (
        "/experiment: swaps: 300=nodes.policy_uniform:Uniform: uniform never takes over: "
        "trials are counted from 1 to 12, over all phantoms"
    )
    assert advice(changed(sim, "experiment", trials=100, swaps=late)) == []
    never = advice(changed(sim, "experiment", plan="repeatability", swaps=late))
    assert [words.endswith("never takes over: it has no trials") for words in never] == [True, True]


def test_a_stage_or_ring_that_an_emulated_phantom_does_not_follow_is_named(runs: list[RunSummary]) -> None:
    sim, emulated = runs
    for node in ("stage", "actuator"):
        assert advice(changed(sim, node, device="drivers.mine:Mine")) == []
        (words,) = advice(changed(emulated, node, device="drivers.mine:Mine"))
        assert words.startswith(f"/{node}: device: drivers.mine:Mine: the emulated phantom follows emulated")


def test_the_check_of_a_launch_file_says_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    checked = check_here(SIM)
    assert check_start(SIM, checked) == []
    faster = [
        msgspec.structs.replace(spec, params=spec.params | {"sweep_speed_m_s": 0.5})
        for spec in checked.nodes
        if spec.name == "stage"
    ]
    nodes = [*(spec for spec in checked.nodes if spec.name != "stage"), *faster]
    (words,) = check_start(SIM, msgspec.structs.replace(checked, nodes=nodes))
    assert "sweep at 0.05 m/s or slower" in words
