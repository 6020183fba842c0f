"""The rig in lockstep: the same bytes as processes, composed, under load, whatever blocks travel."""

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
from tests.support.palp import SIM
from tests.support.rig_session import BriefGraph, ComposedGraph, RigSession, check_here
from tests.support.sessions import without_times

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


def ran(kind: type[BriefGraph], out: Path, *given: str) -> Ran:
    """Run it; it is written where the others are: that is an argument."""
    frames: list[bytes] = []
    overrides = [*SHORT, f"out:={out}", *given]
    with kind(SIM, observe=lambda _, frame: frames.append(frame), overrides=overrides) as graph:
        assert graph.run().exit_code == 0
    files = {path.name: path.read_bytes() for path in (out / "sweeps").iterdir()}
    files |= {name: (out / name).read_bytes() for name in ("trials.csv", "primitives.json")}
    result = without_times(json.loads((out / "result.json").read_text()))
    shutil.rmtree(out)
    return Ran(frames, files, result)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where every session of this file is written."""
    return tmp_path_factory.mktemp("rig") / "out"


@pytest.fixture(scope="module")
def whole(out: Path) -> Ran:
    return ran(ComposedGraph, out)


@pytest.mark.expensive(
    "the rig's nine processes: that they say what a composed graph says is held here alone"
)
def test_processes_and_composition_give_the_same_bytes_and_the_same_result(whole: Ran, out: Path) -> None:
    assert len(whole.files) > 15
    assert ran(BriefGraph, out) == whole


@pytest.mark.nightly
def test_load_changes_no_byte_and_no_result(whole: Ran, out: Path) -> None:
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        assert ran(BriefGraph, out) == whole
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()


@pytest.mark.parametrize(
    ("world", "samples"),
    [
        ("paper", 500),
        *(pytest.param("paper", n, marks=pytest.mark.nightly) for n in (50, 100, 250, 350)),
        *(pytest.param("lab", n, marks=pytest.mark.nightly) for n in (50, 350)),
    ],
)
def test_how_many_samples_travel_together_changes_no_byte_of_the_record(
    world: str, samples: int, whole: Ran, out: Path
) -> None:
    """Times too: the end of a sweep is reported at the same instant, however long blocks are."""
    usual = whole if world == "paper" else ran(ComposedGraph, out, f"world:={world}")
    found = ran(ComposedGraph, out, f"world:={world}", f"stage.block_samples:={samples}")
    assert found.files == usual.files
    counts = [sum(frame.startswith(b"/torque/block\0") for frame in one.frames) for one in (found, usual)]
    assert counts[0] > counts[1]


def test_the_record_names_each_phantoms_rung_bound_and_the_guards_that_acted(rig_session: RigSession) -> None:
    contact = [one for one in rig_session.result["methods"] if one["task"] == "contact"]
    assert [(one["of"], one["method"]) for one in contact] == [("A", "l2"), ("B", "l2"), ("C", "l2")]
    assert all(one["bound"] <= one["tolerance"] for one in contact)
    guards = {code: " ".join(met) for code, met in rig_session.result["mechanics"]["guards"].items()}
    assert "ring_m = 0.016: small strain" in guards["A"]
    assert guards["C"] == ""
    assert "/phantom/guard" in json.dumps(rig_session.digest)


@pytest.mark.parametrize("file", ["sim.yaml", "emulated.yaml"])
def test_the_simulated_phantom_and_the_estimator_read_the_same(file: str) -> None:
    checked = check_here(SIM.with_name(file), ["reading:=trace", "shared.feature:=contrast"])
    params = summary_of(checked, SIM).params
    for name, value in (("reading", "trace"), ("feature", "contrast")):
        assert params["phantom"][name] == params["estimator"][name] == value
