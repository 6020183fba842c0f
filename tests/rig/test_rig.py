"""The rig in lockstep: the same bytes as processes, composed and under load, and a record worth having."""

from __future__ import annotations

import dataclasses
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from palp_core.graph.launch.summary import summary_of
from palp_core.palpation.session.trials_csv import read_rows, read_sweep
from tests.support.palp import SIM
from tests.support.rig_session import BriefGraph, ComposedGraph, RigSession, check_here
from tests.support.sessions import charts_in, without_times

SHORT = (
    "trials:=1",
    "training:=1",
    "seed:=1",
    "policy:=markov",
    "shared.from_m:=-0.012",
    "shared.to_m:=0.012",
)


@dataclasses.dataclass(frozen=True)
class Ran:
    """What a short session comes to: its messages, the files of its record, and its result."""

    frames: list[bytes]
    files: dict[str, bytes]
    result: dict[str, Any]


def ran(kind: type[BriefGraph], out: Path) -> Ran:
    """Run it; it is written where the others are: that is an argument."""
    frames: list[bytes] = []
    with kind(SIM, observe=lambda _, frame: frames.append(frame), overrides=[*SHORT, f"out:={out}"]) as graph:
        assert graph.run().exit_code == 0
    files = {path.name: path.read_bytes() for path in (out / "sweeps").iterdir()}
    files |= {name: (out / name).read_bytes() for name in ("trials.csv", "primitives.json")}
    result = without_times(json.loads((out / "result.json").read_text()))
    shutil.rmtree(out)
    return Ran(frames, files, result)


@pytest.mark.expensive(
    "the rig's nine processes: that they say what a composed graph says is held here alone"
)
def test_processes_and_composition_give_the_same_bytes_and_the_same_result(tmp_path: Path) -> None:
    whole = ran(ComposedGraph, tmp_path / "out")
    assert len(whole.files) > 15
    assert ran(BriefGraph, tmp_path / "out") == whole


@pytest.mark.nightly
def test_load_changes_no_byte_and_no_result(tmp_path: Path) -> None:
    whole = ran(ComposedGraph, tmp_path / "out")
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        assert ran(BriefGraph, tmp_path / "out") == whole
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()


def test_the_record_names_each_phantoms_rung_bound_and_the_guards_that_acted(rig_session: RigSession) -> None:
    contact = [one for one in rig_session.result["methods"] if one["task"] == "contact"]
    assert [(one["of"], one["method"]) for one in contact] == [("A", "l2"), ("B", "l2"), ("C", "l2")]
    assert all(one["bound"] <= one["tolerance"] for one in contact)
    guards = {code: " ".join(met) for code, met in rig_session.result["mechanics"]["guards"].items()}
    assert "ring_m = 0.016: small strain" in guards["A"]
    assert guards["C"] == ""
    assert "/phantom/guard" in json.dumps(rig_session.digest)


def test_a_session_leaves_a_whole_record_and_a_report(rig_session: RigSession) -> None:
    out, result = rig_session.out, rig_session.result
    rows = read_rows(out)
    training = [row for row in rows if row.phase == "training"]
    assert len(training) == 2 * 3 * 5
    assert {row.trial for row in rows if row.phase == "estimation"} == set(range(1, 7))
    assert [row.row for row in rows] == list(range(len(rows)))
    for row in rows:
        torque_n_m, rate_hz = read_sweep(out, row.row)
        assert rate_hz == 1000.0
        assert len(torque_n_m) == 4000
        assert row.start_ns < row.end_ns
        assert row.true_ring_m is not None
        assert abs(row.true_ring_m - row.ring_m) <= 0.3e-3 + 1e-12
    for key in (
        "policy", "seed", "trials", "accuracy", "probes_mean", "stop_rule", "verdicts", "calibration",
        "protocol", "sim_time_s", "wall_time_s", "sweep_s_per_wall_s",
    ):  # fmt: skip
        assert key in result
    page = (out / "report.html").read_text()
    assert "this session only" in page
    assert "accuracy" in charts_in(out / "report.html")


@pytest.mark.parametrize("file", ["sim.yaml", "emulated.yaml"])
def test_the_simulated_phantom_and_the_estimator_read_the_same(file: str) -> None:
    checked = check_here(SIM.with_name(file), ["reading:=trace", "shared.feature:=contrast"])
    params = summary_of(checked, SIM).params
    for name, value in (("reading", "trace"), ("feature", "contrast")):
        assert params["phantom"][name] == params["estimator"][name] == value
