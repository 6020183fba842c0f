"""The experiment with simulated people, from the consent to a policy that follows what they did."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from palp_core.cli.rig import emg
from palp_core.cli.session import app
from palp_core.graph.bag.reader import Bag
from palp_core.palpation.identification.emg.markov_fit import EmgRecordingPath, chain_file, fit
from palp_core.palpation.identification.emg.muscles import ImportOptions
from palp_core.palpation.perception.emg.analysis import EmgSettings
from palp_core.palpation.perception.strategy.chain_file import markov_policy, write_chains
from palp_core.palpation.session import audit
from palp_core.palpation.session.human.record import read_human
from tests.palpation.session.sheet.test_sheet import FILLED
from tests.support.palp import ROOT
from tests.support.rig_session import ComposedGraph, check_here

HUMAN = ROOT / "launch/human.yaml"


def session(out: Path, number: int, **given: object) -> Path:
    """Run a session with a simulated person."""
    known = {"subject": f"S{number:02d}", "consent": f"C-{number}", "subject_number": number, "seed": number}
    with ComposedGraph(HUMAN, out=out, rest_s=0.0, **{**known, **given}) as graph:
        assert graph.run().exit_code == 0
    return out


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two subjects, a trial of 2 s a phantom and phase; only to be read."""
    folder = tmp_path_factory.mktemp("study")
    small = {"order": "counterbalanced", "repeats": 1, "palpation_s": 2.0}
    (folder / "S01.yaml").write_text(FILLED.partition("sensor:")[0])
    first = session(folder / "S01", 1, session=folder / "S01.yaml", **small)
    return [first, session(folder / "S02", 2, **small)]


def test_the_sheet_goes_with_all_that_is_kept(study: list[Path]) -> None:
    assert "lab: Motor Lab, 2nd floor" in (study[0] / "session.yaml").read_text()
    assert json.loads((study[0] / "human.json").read_text())["session"]["ethics"] == "17-204"
    assert "Motor Lab, 2nd floor" in (study[0] / "human.html").read_text()
    shown = [CliRunner().invoke(app, ["show", str(path)]).stdout for path in (study[0], study[0] / "bag")]
    assert all("17-204" in text for text in shown)
    assert "simulation" in (study[1] / "session.yaml").read_text()


def test_the_kept_emg_is_what_was_measured(study: list[Path]) -> None:
    row = read_human(study[0])[0]
    with np.load(study[0] / row.emg) as kept:
        fds_v = kept["fds_v"]
    with Bag(study[0] / "bag") as bag:
        blocks = [one.value for one in bag.messages(["/emg/block"]) if one.value.phase == "palpation"]
    assert fds_v.size >= 2.0 * 1500 - 1
    measured = np.concatenate([block.fds_v for block in blocks])[: fds_v.size]
    np.testing.assert_array_equal(fds_v, measured)


def test_a_recording_may_stand_for_the_person_and_has_no_accuracy_either(
    study: list[Path], tmp_path: Path
) -> None:
    """Each phase of an earlier session's bag is played while it is asked for."""
    small = {"order": "counterbalanced", "repeats": 1, "palpation_s": 1.0}
    who = {"emg": "file", "recording": study[0] / "bag", "clock": "sim", "operator": "script"}
    out = session(tmp_path / "S01", 1, **small, **who)
    rows = read_human(out)
    assert len(rows) == 6
    assert {row.source for row in rows} == {"file"}
    assert all(row.emg and row.lost_count == 0 for row in rows)
    assert "the muscles are a recording's" in json.loads((out / "human.json").read_text())["note"]
    with np.load(out / "emg/S01/mvc.npz") as kept, np.load(study[0] / "emg/S01/mvc.npz") as first:
        rms = [float(np.sqrt(np.nanmean(one["fds_v"] ** 2))) for one in (kept, first)]
    assert rms[0] == pytest.approx(rms[1], rel=0.1)


def test_a_simulated_person_has_no_accuracy_in_any_file(study: list[Path]) -> None:
    for folder in study:
        assert json.loads((folder / "human.json").read_text())["accuracy"] is None
        page = (folder / "human.html").read_text()
        assert "no accuracy: the muscles are simulated" in page
        assert "Right:" not in page
    done = CliRunner().invoke(app, ["people", *map(str, study), "--json"])
    found = json.loads(done.stdout)
    assert found["trials"] == {"training": 6, "estimation": 6}
    assert found["accuracy"] is None
    assert "confusion" not in found


def test_what_they_did_becomes_chains_that_the_policy_follows(study: list[Path], tmp_path: Path) -> None:
    sources = [EmgRecordingPath(folder) for folder in study]
    found = fit(sources, None, ImportOptions(), EmgSettings(), np.random.default_rng(1), report=pytest.fail)
    assert [(one.depth_m, one.trial_count) for one in found.chains] == [
        (None, 12),
        (0.002, 4),
        (0.004, 4),
        (0.008, 4),
    ]
    write_chains(chain_file(found), tmp_path / "chain.json")
    markov_policy(str(tmp_path / "chain.json"))
    check_here(ROOT / "launch/sim.yaml", [f"shared.chain:={tmp_path / 'chain.json'}", "policy:=markov"])


def test_a_trial_that_was_excluded_teaches_no_chain(study: list[Path], tmp_path: Path) -> None:
    import shutil

    folder = Path(shutil.copytree(study[0], tmp_path / "S01"))
    audit.decide(folder, ("estimation", 2), "exclude", "the subject looked")
    done = CliRunner().invoke(emg.app, ["fit-policy", str(folder), "--json"])
    assert len(json.loads(done.stdout)["trials"]) == 5
