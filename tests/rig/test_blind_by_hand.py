"""A blinded session with a person: depths are told in training, and nobody knows them in estimation."""

from __future__ import annotations

import csv
import json
import shutil
import struct
from pathlib import Path

import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app as palp
from palp_core.cli.rig import emg
from palp_core.cli.session.session import app
from palp_core.graph.bag.reader import Bag
from palp_core.graph.problems import GraphProblems
from palp_core.palpation.mechanics.scene.sealed import own_codes, standing
from palp_core.palpation.session.decided.audit import decisions
from palp_core.palpation.session.human.record import HUMAN_TABLE, HumanRow, read_human
from palp_core.palpation.session.many.overview import find_sessions
from palp_core.palpation.session.many.page import rows_of
from palp_core.palpation.session.operating.unsealing import sealed_name
from tests.rig.test_human import HUMAN, session
from tests.support.rig_session import check_here

DEPTHS_M = {"A": 0.0021373, "B": 0.0042917, "C": 0.0067131}
"""Numbers that nothing else in a run has."""


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("by_hand")
    phantoms = folder / "phantoms.yaml"
    phantoms.write_text("".join(f"{code}: {{bead: {{depth_m: {d}}}}}\n" for code, d in DEPTHS_M.items()))
    small = {"order": "counterbalanced", "repeats": 1, "palpation_s": 2.0, "blind": True}
    return session(folder / "S01", 1, phantoms=phantoms, **small)


def test_estimation_has_codes_in_table_files_and_messages_and_training_depths(out: Path) -> None:
    rows = read_human(out)
    codes = standing(out / "key.sealed")
    training, estimation = rows[:3], rows[3:]
    assert {row.phantom: row.depth_m for row in training} == DEPTHS_M
    assert sorted(row.phantom for row in estimation) == sorted(codes)
    assert {row.depth_m for row in estimation} == {None}
    assert all(row.phantom in row.emg for row in estimation)
    with Bag(out / "bag") as bag:
        begun = [one.value for one in bag.messages(["/session/begun"])]
        told = b"\0".join(one.payload for one in bag.recorded(["/session/begun", "/session/cue"]))
    assert [one.depth_m for one in begun[3:]] == [0.0] * 3
    assert told.count(struct.pack(">d", DEPTHS_M["A"])) == 1  # of training
    assert json.loads((out / "human.json").read_text())["accuracy"] is None


def test_an_export_has_codes_and_no_depth_of_estimation_either(out: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(
        palp, ["session", "export", str(out), "--to", "csv", "--out", str(tmp_path / "csv")]
    )
    assert done.exit_code == 0, done.output
    with (tmp_path / "csv" / "human_trials.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["phantom"]: float(row["depth_m"]) for row in rows[:3]} == DEPTHS_M
    assert {row["phantom"] for row in rows[3:]} == set(standing(out / "key.sealed"))
    assert {row["depth_m"] for row in rows[3:]} == {""}


def test_unsealed_it_has_the_depths_and_what_was_written_before_is_kept(out: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(out, tmp_path / "copy"))
    before = (copy / "human_trials.csv").read_bytes()
    own = own_codes(copy / "key.sealed")
    done = CliRunner().invoke(app, ["unseal", str(copy), "--reason", "all is done"])
    assert done.exit_code == 0, done.output
    rows = read_human(copy)
    assert [row.depth_m for row in rows[3:]] == [DEPTHS_M[own[row.phantom]] for row in rows[3:]]
    assert sealed_name(copy / HUMAN_TABLE).read_bytes() == before
    assert [(one.deed, one.reason) for one in decisions(copy)] == [("unseal", "all is done")]
    learnt = json.loads(CliRunner().invoke(emg.app, ["fit-policy", str(copy), "--json"]).stdout)
    assert [one["depth_m"] for one in learnt["trials"]] == [row.depth_m for row in by_file(rows)]
    again = CliRunner().invoke(app, ["unseal", str(copy), "--reason", "again"])
    assert "is not sealed" in str(again.exception)


def test_a_folder_of_sessions_tells_that_it_is_blinded_and_its_report_is_made_again(
    out: Path, tmp_path: Path
) -> None:
    copy = Path(shutil.copytree(out, tmp_path / "copy"))
    (entry,) = find_sessions(copy)
    assert entry.words == "with a person, 6 trials, 3 of them blinded, whole"
    assert rows_of([entry], copy)[1][4] == "-"
    (copy / "human.html").unlink()
    done = CliRunner().invoke(palp, ["session", "report", str(copy)])
    assert done.exit_code == 0, done.output
    assert (copy / "human.html").exists()
    analysed = CliRunner().invoke(palp, ["emg", "analyse", str(copy), "--json"])
    assert {one["subject"] for one in json.loads(analysed.stdout)["trials"]} == {"S01"}


def by_file(rows: list[HumanRow]) -> list[HumanRow]:
    return sorted(rows, key=lambda row: row.emg)


def test_while_it_is_sealed_strategies_are_learnt_of_told_depths_and_of_all(out: Path) -> None:
    done = CliRunner().invoke(emg.app, ["fit-policy", str(out), "--json"])
    learnt = json.loads(done.stdout)
    told = [row.depth_m for row in by_file(read_human(out))]
    assert [one["depth_m"] for one in learnt["trials"]] == told
    assert told.count(None) == 3
    assert "the depth of 3 trials is sealed" in done.stderr


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("order:=paper", "tells of each trial which depth it has"),
        ("emg:=lsl", "palp session seal KEY"),
    ],
)
def test_what_would_tell_is_refused_before_anything_starts(given: str, said: str, tmp_path: Path) -> None:
    order = [] if given.startswith("order") else ["order:=counterbalanced"]
    with pytest.raises(GraphProblems, match=said):
        check_here(HUMAN, ["blind:=true", given, *order, f"out:={tmp_path / 'out'}"])
    check_here(HUMAN, ["blind:=true", "order:=counterbalanced", f"out:={tmp_path / 'out'}"])
    assert not (tmp_path / "out").exists()
    CliRunner().invoke(app, ["seal", str(tmp_path / "key")])
    sealed = [f"phantoms:={tmp_path / 'key'}", "order:=counterbalanced"]
    check_here(HUMAN, ["blind:=true", "emg:=lsl", *sealed, f"out:={tmp_path / 'out'}"])
