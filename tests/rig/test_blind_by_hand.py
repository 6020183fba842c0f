"""A blinded session with a person: depths are known in training, and to no one in estimation."""

from __future__ import annotations

import csv
import json
import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app as palp
from palp_core.cli.rig import emg
from palp_core.cli.session import app
from palp_core.errors import PalpError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.problems import GraphProblems
from palp_core.palpation.mechanics.scene.sealed import SEAL, own_codes, seal, sealed_phantoms
from palp_core.palpation.session.audit import decisions
from palp_core.palpation.session.bag_record import launch_of
from palp_core.palpation.session.human.blinding import DIGEST, refuse_other_key, sealed_name, unseal
from palp_core.palpation.session.human.record import HUMAN_TABLE, HumanRow, read_human
from palp_core.palpation.session.many.overview import find_sessions
from palp_core.palpation.session.many.pooled import rows_of
from palp_core.palpation.session.run_note import read_note, refuse_resuming
from palp_core.sealing import opened, sealed
from palp_core.whole_file import is_locked, write_json, write_whole
from tests.rig.test_human import HUMAN, session
from tests.support.palp import ROOT
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
    codes = own_codes(out / "key.sealed")
    training, estimation = rows[:3], rows[3:]
    assert {row.phantom: row.depth_m for row in training} == DEPTHS_M
    assert sorted(row.phantom for row in estimation) == sorted(codes)
    assert {row.depth_m for row in estimation} == {None}
    assert all(row.phantom in row.emg for row in estimation)
    with Bag(out / "bag") as bag:
        begun = [one.value for one in bag.messages(["/session/begun"])]
        open_to_all = b"\0".join(one.payload for one in bag.recorded(["/session/begun", "/session/cue"]))
        coded = [(one.stream.topic.name, bytes(one.payload)) for one in bag.recorded()]
        launch = str(bag.attachments()).encode()
    assert [one.depth_m for one in begun[3:]] == [0.0] * 3
    assert open_to_all.count(struct.pack(">d", DEPTHS_M["A"])) == 1  # of training
    assert not any(code.encode() in launch for code in codes)
    for code, own in codes.items():  # what a page or palp topic echo gets; an answer may well be right
        shown = [payload for name, payload in coded if code.encode() in payload and name != "/session/result"]
        assert shown
        assert not any(struct.pack(">d", DEPTHS_M[own]) in payload for payload in shown)
    assert json.loads((out / "human.json").read_text())["accuracy"] is None


def test_an_export_has_codes_and_no_depth_of_estimation_either(out: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(
        palp, ["session", "export", str(out), "--to", "csv", "--out", str(tmp_path / "csv")]
    )
    assert done.exit_code == 0, done.output
    with (tmp_path / "csv" / "human_trials.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["phantom"]: float(row["depth_m"]) for row in rows[:3]} == DEPTHS_M
    assert {row["phantom"] for row in rows[3:]} == set(own_codes(out / "key.sealed"))
    assert {row["depth_m"] for row in rows[3:]} == {""}


@pytest.fixture
def copy(out: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(out, tmp_path / "copy"))


def test_unsealed_it_has_the_depths_and_what_was_written_before_is_kept(copy: Path) -> None:
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


def test_a_folder_of_sessions_says_that_it_is_blinded_and_its_report_is_made_again(copy: Path) -> None:
    (entry,) = find_sessions(copy)
    assert entry.words == "with a person, 6 trials, 3 of them blinded, whole"
    assert rows_of([entry], copy)[1][4] == "-"
    (copy / "human.html").unlink()
    done = CliRunner().invoke(palp, ["session", "report", str(copy)])
    assert done.exit_code == 0, done.output
    assert (copy / "human.html").exists()
    analysed = CliRunner().invoke(palp, ["emg", "analyse", str(copy), "--json"])
    assert {one["subject"] for one in json.loads(analysed.stdout)["trials"]} == {"S01"}


@pytest.mark.parametrize("done", range(3))
def test_unsealing_that_was_cut_off_is_finished_by_the_next_run(
    copy: Path, tmp_path: Path, done: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Path(shutil.copytree(copy, tmp_path / "whole"))
    unseal(whole, "all is done")
    left = [done]

    def write_some(path: Path, content: Any) -> None:
        assert is_locked(copy)  # no other opens the session meanwhile
        if not left[0]:
            raise OSError("disk full")
        left[0] -= 1
        if isinstance(content, dict):
            write_json(path, content)
        else:
            write_whole(path, content)

    for name in ("write_whole", "write_json"):
        monkeypatch.setattr(f"palp_core.palpation.session.human.blinding.{name}", write_some)
    with pytest.raises(OSError, match="disk full"):
        unseal(copy, "all is done")
    monkeypatch.undo()
    unseal(copy, "all is done")
    with pytest.raises(PalpError, match="is not sealed"):
        unseal(copy, "all is done twice")
    assert [(one.deed, one.reason) for one in decisions(copy)] == [("unseal", "all is done")]
    for name in (HUMAN_TABLE, sealed_name(Path(HUMAN_TABLE)).name, "key.json"):
        assert (copy / name).read_bytes() == (whole / name).read_bytes()


def test_a_session_is_either_unsealed_or_resumed(copy: Path) -> None:
    (copy / "checkpoint").touch()
    with pytest.raises(PalpError, match=r"unfinished.*palp launch --resume, or remove"):
        unseal(copy, "curious")
    (copy / "checkpoint").unlink()
    refuse_resuming(copy, HUMAN_TABLE)
    unseal(copy, "all is done")
    with pytest.raises(PalpError, match="was unsealed"):
        refuse_resuming(copy, HUMAN_TABLE)


def other_phantoms(key: Path) -> bytes:
    """Return a key with codes of its own for the same phantoms."""
    other = key.with_name("other")
    seal(other, sealed_phantoms(key))
    return other.read_bytes()


def exchanged_depths(key: Path) -> bytes:
    """Return a key with the same codes, in which two phantoms have each other's depth and own code."""
    content = json.loads(opened(SEAL, key.read_bytes()))
    first, second, *_ = sorted(content["was"])
    for depths in (content["phantoms"], content["was"]):
        depths[first], depths[second] = depths[second], depths[first]
    return sealed(SEAL, json.dumps(content).encode())


@pytest.mark.parametrize("forge", [other_phantoms, exchanged_depths])
def test_another_key_opens_nothing_and_resumes_nothing(copy: Path, forge: Callable[[Path], bytes]) -> None:
    key = copy / "key.sealed"
    key.write_bytes(forge(key))
    before = {path: path.read_bytes() for path in copy.iterdir() if path.is_file()}
    with pytest.raises(PalpError, match="another session's key, or was changed"):
        unseal(copy, "with the wrong key")
    assert {path: path.read_bytes() for path in copy.iterdir() if path.is_file()} == before
    summary = read_note(copy)
    of_copy = {node: of | {"key": str(key)} if "key" in of else of for node, of in summary.params.items()}
    resumed = msgspec.structs.replace(summary, params=of_copy)
    with pytest.raises(PalpError, match="another session's key, or was changed"):
        refuse_other_key(resumed, copy)
    key.unlink()
    with pytest.raises(PalpError, match="is missing, and only it has the phantoms' codes"):
        refuse_other_key(resumed, copy)


def test_the_digest_of_the_key_belongs_to_the_run_and_its_bag(out: Path) -> None:
    summary = read_note(out)
    refuse_other_key(summary, out)
    with Bag(out / "bag") as bag:
        assert launch_of(bag).attached[DIGEST] == summary.attached[DIGEST]


@pytest.mark.parametrize(
    ("gone", "damage", "words"),
    [
        ("", lambda head, *rows: [head], "has no rows"),
        ("", lambda head, *rows: [head, *rows[:5], rows[5][:40]], "the last row is cut short: '5,S01"),
        (
            "human.json",
            lambda head, *rows: [head, *rows[:5]],
            "has no row of the trial emg/S01/estimation/03_",
        ),
        ("emg", lambda head, *rows: [head, *rows[:5]], "has 5 of the 6 trials in human.json; restore"),
        ("emg", lambda head, *rows: [head, *rows[:3], *rows[4:]], "csv:5: row 3 is missing before it"),
        (
            "",
            lambda head, *rows: [head, *rows[:5], with_code(rows[5], "Z9")],
            "row 5: no code 'Z9' in .*key.sealed",
        ),
    ],
)
def test_a_table_that_lacks_a_trial_is_not_unsealed(
    copy: Path, gone: str, damage: Callable[..., list[str]], words: str
) -> None:
    if gone:
        (copy / gone).rename(copy.with_name("gone"))
    table = copy / HUMAN_TABLE
    table.write_text("".join(damage(*table.read_text().splitlines(keepends=True))))
    before = {path: path.read_bytes() for path in copy.iterdir() if path.is_file()}
    with pytest.raises(PalpError, match=words):
        unseal(copy, "all is done")
    assert {path: path.read_bytes() for path in copy.iterdir() if path.is_file()} == before


def with_code(row: str, code: str) -> str:
    """Return a row of another phantom, with the EMG that it has."""
    cells = row.split(",")
    cells[list(HumanRow.__struct_fields__).index("phantom")] = code
    return ",".join(cells)


@pytest.mark.parametrize("file", ["sim.yaml", "emulated.yaml", "rig.yaml", "human.yaml"])
def test_a_sealed_key_is_read_by_no_session_in_the_open(file: str, out: Path) -> None:
    """It would tell the depth of each code, and no audit would know."""
    key = out / "key.sealed"
    given = [f"phantoms:={key}", *(["order:=counterbalanced"] if file == "human.yaml" else [])]
    with pytest.raises(GraphProblems, match="is sealed: reading it would unblind the session"):
        check_here(ROOT / "launch" / file, given)
    shown = CliRunner().invoke(app, ["plan", "--phantoms", str(key), "--order", "counterbalanced"])
    assert "is sealed" in str(shown.exception)
    assert shown.output == ""


def by_file(rows: list[HumanRow]) -> list[HumanRow]:
    return sorted(rows, key=lambda row: row.emg)


def test_while_it_is_sealed_strategies_are_learnt_of_known_depths_and_of_all(out: Path) -> None:
    done = CliRunner().invoke(emg.app, ["fit-policy", str(out), "--json"])
    learnt = json.loads(done.stdout)
    known = [row.depth_m for row in by_file(read_human(out))]
    assert [one["depth_m"] for one in learnt["trials"]] == known
    assert known.count(None) == 3
    assert "the depth of 3 trials is sealed" in done.stderr


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        ("order:=paper", "order:=paper is published"),
        ("emg:=lsl", "palp session seal KEY"),
    ],
)
def test_what_would_unblind_is_refused_before_anything_starts(given: str, shown: str, tmp_path: Path) -> None:
    order = [] if given.startswith("order") else ["order:=counterbalanced"]
    with pytest.raises(GraphProblems, match=shown):
        check_here(HUMAN, ["blind:=true", given, *order, f"out:={tmp_path / 'out'}"])
    check_here(HUMAN, ["blind:=true", "order:=counterbalanced", f"out:={tmp_path / 'out'}"])
    assert not (tmp_path / "out").exists()
    CliRunner().invoke(app, ["seal", str(tmp_path / "key")])
    sealed = [f"phantoms:={tmp_path / 'key'}", "order:=counterbalanced"]
    check_here(HUMAN, ["blind:=true", "emg:=lsl", *sealed, f"out:={tmp_path / 'out'}"])
