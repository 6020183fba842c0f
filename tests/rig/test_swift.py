"""A decision within the sweep, in whole runs: the stage stops, and the record lets it be made again."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from nodes.experiment import Experiment
from palp_core.graph.bag.reader import Bag
from palp_core.graph.replay.replay import replay
from palp_core.palpation.session.reanalysis import Methods, reanalyse
from palp_core.palpation.session.recorded_sweeps import read_sweeps
from palp_core.palpation.session.trials_csv import Row, read_rows
from tests.rig.test_emulated import LENIENT
from tests.support.palp import Palp, palp
from tests.support.rig_session import ComposedGraph, check_here

__all__ = ["palp"]

ROOT = Path(__file__).resolve().parents[2]
SIM = ROOT / "launch" / "sim.yaml"
WHOLE_S = 2.5
SWIFT = Methods(stop="posterior_threshold", stop_value=0.99, trace_filter="second_order")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of two trials a phantom, with the ring moved between probes, and its bag.

    The register takes the cheapest contact model for its slopes: finite elements take half a minute.
    """
    path = tmp_path_factory.mktemp("swift")
    (path / "scene.yaml").write_text("tolerance: {relative: 1.0}\n")
    with ComposedGraph(
        SIM, record=path / "bag", out=path / "out", protocol="swift", trials=2, training=2,
        policy="uniform", scene=path / "scene.yaml",
    ) as graph:  # fmt: skip
        assert graph.run().exit_code == 0
    return path


@pytest.fixture(scope="module")
def rows(folder: Path) -> list[Row]:
    return [row for row in read_rows(folder / "out") if row.phase == "estimation"]


def length_s(row: Row) -> float:
    return (row.end_ns - row.start_ns) * 1e-9


def test_trials_end_within_a_sweep_and_the_record_has_what_was_swept(folder: Path, rows: list[Row]) -> None:
    stored = {(one.trial, one.iteration): one for one in read_sweeps(folder / "out").sweeps}
    ends = [row for row in rows if row.verdict == "decided"]
    assert len({row.trial for row in rows}) == len(ends) == 6
    assert sum(length_s(row) < WHOLE_S - 0.2 for row in ends) >= 4
    for row in rows:
        sweep = stored[row.trial, row.iteration]
        assert len(sweep.torque_n_m) == round(length_s(row) * 1000) + 1
        if row.verdict == "continue":
            assert len(sweep.torque_n_m) >= WHOLE_S * 1000
        else:
            assert max(row.posterior) >= 0.99


@pytest.mark.parametrize("kind", ["out", "bag"])
def test_the_nodes_own_verdicts_are_found_again_bit_by_bit(folder: Path, rows: list[Row], kind: str) -> None:
    session = read_sweeps(folder / kind)
    again = reanalyse(session, SWIFT)
    found = [list(posterior) for trial in again.trials for posterior in trial.posteriors]
    assert found == [row.posterior for row in rows]
    assert [trial.verdict for trial in again.trials] == ["decided"] * 6
    assert [t.estimate_m for t in again.trials] == [r.estimate_m for r in rows if r.verdict == "decided"]


def by_topic(bag: Path) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    with Bag(bag) as opened:
        for message in opened.messages():
            found.setdefault(message.topic, []).append(message)
    return found


def test_the_stage_rests_within_a_millimetre_of_the_block_that_decided(folder: Path) -> None:
    published = by_topic(folder / "bag")
    decided = [one for one in published["/estimator/outlook"] if one.value.verdict == "decided"]
    cancelled = [one for one in published["/stage/status"] if one.value.status == "cancelled"]
    assert 4 <= len(cancelled) <= len(decided)
    speed, brakes_m = 0.020, 0.020**2 / 2.0
    for stop in cancelled:
        last = max(one.value.sample_ns for one in decided if one.log_ns <= stop.log_ns)
        assert (stop.value.stamp_ns - last) * 1e-9 * speed + brakes_m < 1e-3 + 0.050 * speed
    resting = {one.value.goal_id for one in published["/stage/status"] if one.value.status == "ready"}
    assert {stop.value.goal_id for stop in cancelled[:-1]} <= resting  # the run ends with the last decision


def test_replayed_nodes_say_the_same_again(
    folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(Experiment, "records", False)
    monkeypatch.chdir(tmp_path)
    for one in replay(folder / "bag", ["estimator", "stage"], ROOT):
        assert one.divergence is None, one.divergence
        assert one.compared > 0


@pytest.mark.parametrize("file", ["sim.yaml", "emulated.yaml"])
def test_each_setting_of_the_protocol_can_be_given(file: str) -> None:
    swift = check_here(
        ROOT / "launch" / file, ["protocol:=swift", "shared.stop_value:=0.9", "shared.lift_mm:=7"]
    )
    by_name = {spec.name: spec.params for spec in swift.nodes}
    assert (by_name["estimator"]["reading"], by_name["estimator"]["stop_value"]) == ("trace", 0.9)
    assert (by_name["experiment"]["rehome"], by_name["stage"]["lift_mm"]) == ("never", 7.0)
    for node in ("experiment", "estimator", "phantom"):
        assert (by_name[node]["from_m"], by_name[node]["to_m"]) == (-0.026, 0.034)


@pytest.mark.nightly
def test_on_emulated_devices_it_decides_within_the_sweep_and_nothing_trips(
    palp: Palp, tmp_path: Path
) -> None:
    out, host = tmp_path / "out", f"127.{os.getpid() >> 8 & 255}.{os.getpid() & 255}.11"
    few = (
        "trials:=1",
        "training:=1",
        "shared.trace_filter:=second_order",
    )  # for so little training none has a bound
    small = ("policy:=fixed", *few, "rings_mm:=8, 16", f"host:={host}", f"out:={out}")
    emulated = ROOT / "launch" / "emulated.yaml"
    done = palp.run("launch", emulated, "protocol:=swift", *small, *LENIENT, "--record", tmp_path / "bag")
    assert done.returncode == 0, done.stderr
    ends = [row for row in read_rows(out) if row.verdict == "decided"]
    assert len(ends) == 3
    published = by_topic(tmp_path / "bag")
    decided_ns = [one.publish_ns for one in published["/estimator/outlook"] if one.value.verdict == "decided"]
    for row in ends:  # a slow machine decides late: what was decided in time ends the sweep, and nothing else
        first_ns = min((ns for ns in decided_ns if row.start_ns <= ns), default=row.end_ns)
        spare_s = WHOLE_S - (first_ns - row.start_ns) * 1e-9
        assert length_s(row) < WHOLE_S - 0.2 or spare_s < 0.5
        assert length_s(row) >= WHOLE_S - 0.2 or first_ns <= row.end_ns
    again = reanalyse(read_sweeps(out), SWIFT)
    assert [trial.estimate_m for trial in again.trials] == [row.estimate_m for row in ends]
    assert "/safety/trip" not in published
