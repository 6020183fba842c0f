"""``palp session list``: every session of a folder in words, and what they say together."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from zlib import crc32

import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.errors import PalpError
from palp_core.graph.launch.summary import RunSummary
from palp_core.palpation.export.export import write_export
from palp_core.palpation.export.source import read_source
from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap
from palp_core.palpation.session.many.overview import SessionEntry, find_sessions
from palp_core.palpation.session.many.pooled import pool, remarks
from palp_core.palpation.session.session_folder import SHEET
from palp_core.palpation.session.sheet.sheet import SessionSheet, sheet_text
from palp_core.whole_file import write_json
from tests.palpation.reporting.page_flaws import flaws
from tests.support.sessions import describe, writer

SURE = {0: [0.9, 0.05, 0.05], 1: [0.05, 0.9, 0.05], 2: [0.05, 0.05, 0.9]}


def trials(*right: bool) -> list[tuple[int, list[list[float]]]]:
    """Return trials at all depths in turn, right or wrong."""
    return [(i % 3, [SURE[i % 3 if one else (i + 1) % 3]]) for i, one in enumerate(right)]


def session(
    folder: Path,
    name: str,
    right: Sequence[bool],
    *,
    subject: str = "",
    policy: str = "markov",
    seed: int = 3,
    exit_code: int = 0,
    began: str = "2026-11-22_21-05-09",
    **record: Any,
) -> Path:
    """Write a session with its note; its sheet names a subject, if one is given."""
    out = writer(folder)(name, trials=trials(*right), **({"repeats": 0} | record))
    sheet = SessionSheet(
        lab="L", operator="OP", subject=subject or "none", began=began, simulated=not subject
    )
    summary = describe(out)
    params = {**summary.params, "experiment": {**summary.params["experiment"], "policy": policy, "trials": 2}}
    ended = "" if exit_code == 0 else "Ctrl-C"
    note = msgspec.structs.replace(
        summary,
        params=params,
        seed=seed,
        exit_code=exit_code,
        ended=ended,
        attached={SHEET: sheet_text(sheet)},
    )
    write_json(out / "run.json", note)
    # sessions differ in a digit of their record, as real ones do; a copy is one whose record is the same
    table = (out / "trials.csv").read_text(encoding="utf-8")
    table = table.replace(",markov,", f",{policy},").replace("markov-3", f"{policy}-{crc32(name.encode())}")
    (out / "trials.csv").write_text(table, encoding="utf-8")
    return out


def listed(folder: Path) -> dict[str, SessionEntry]:
    return {one.path.name: one for one in find_sessions(folder)}


def test_each_session_is_listed_in_words_whatever_its_state(tmp_path: Path) -> None:
    session(tmp_path / "a", "whole", [True, False], subject="S01")
    session(tmp_path, "stopped", [True, True], exit_code=130)
    bad = session(tmp_path, "bad", [True], repeats=1)
    lines = (bad / "trials.csv").read_text(encoding="utf-8").splitlines()
    (bad / "trials.csv").write_text("\n".join([*lines[:3], lines[3][:20], *lines[4:], ""]), encoding="utf-8")
    (session(tmp_path, "torn", [True]) / "run.json").write_text("{", encoding="utf-8")
    note = session(tmp_path, "retyped", [True]) / "run.json"
    note.write_text(
        re.sub(r'"file": ?"[^"]*"', '"file": 3', note.read_text(encoding="utf-8")), encoding="utf-8"
    )
    (session(tmp_path, "unknown", [True]) / "run.json").unlink()
    shutil.rmtree(session(tmp_path, "nothing", [True]) / "sweeps")
    (tmp_path / "nothing" / "trials.csv").unlink()
    (tmp_path / "beside").mkdir()
    found = listed(tmp_path)
    assert {name: one.state for name, one in found.items()} == {
        "whole": "whole",
        "stopped": "unfinished",
        "bad": "damaged",
        "torn": "damaged",
        "retyped": "damaged",
        "unknown": "damaged",
        "nothing": "empty",
    }
    assert found["whole"].who == "S01, OP"
    assert found["whole"].began == "2026-11-22 21:05"
    assert len(found["whole"].trials) == 2
    assert found["stopped"].words == "unfinished: 2 of 6 trials, because: Ctrl-C"
    assert "trials.csv:4: the row is damaged" in found["bad"].words
    assert "run.json cannot be read" in found["torn"].words
    assert re.search(
        r"run.json cannot be read: file must be a text, not a whole number; restore", found["retyped"].words
    )
    assert "run.json is missing" in found["unknown"].words
    assert found["unknown"].began.startswith("~")


def test_a_session_that_is_being_written_is_running(tmp_path: Path) -> None:
    session(tmp_path, "now", [True], exit_code=-1)  # the writer of a record keeps its folder
    (found,) = find_sessions(tmp_path)
    assert found.state == "running"
    assert found.words.startswith("running: 1 of 6 trials")


def test_a_folder_may_be_one_session_but_links_and_exported_tables_are_none(tmp_path: Path) -> None:
    out = session(tmp_path / "study", "one", [True], repeats=1)
    assert [one.path for one in find_sessions(out)] == [out]
    (tmp_path / "study/latest").symlink_to("one", target_is_directory=True)
    write_export(read_source(out), "csv", tmp_path / "study/one_csv")
    assert [one.path for one in find_sessions(tmp_path)] == [out]
    (tmp_path / "empty").mkdir()
    with pytest.raises(PalpError, match="has no session"):
        find_sessions(tmp_path / "empty")
    with pytest.raises(PalpError, match="no such folder"):
        find_sessions(tmp_path / "nowhere")


def test_sessions_of_one_subject_are_one_unit_but_of_one_subject_alone(tmp_path: Path) -> None:
    for subject, right in (("S01", [True] * 3), ("S02", [False] * 3)):
        for day in range(3):
            session(tmp_path / "two", f"{subject}-{day}", right, subject=subject)
    for day, right in enumerate(([True] * 3, [True, False, False], [False] * 3)):
        session(tmp_path / "one", f"day{day}", right, subject="S01")
    for folder, unit, shares in (("two", "subject", [1.0, 0.0]), ("one", "session", [1.0, 1 / 3, 0.0])):
        (group,) = pool(find_sessions(tmp_path / folder))["groups"]
        assert (group["unit"], group["units"]) == (unit, len(shares))
        wanted = cluster_bootstrap(shares, np.random.default_rng(1), within=(0.0, 1.0))
        assert group["accuracy"]["value"] == pytest.approx(np.mean(shares))
        assert group["accuracy"]["ci"] == pytest.approx([wanted.low, wanted.high])
        assert group["accuracy_per_depth_mm"].keys() == {"2", "4", "8"}
    assert group["remarks"] == ["all sessions are of S01: the results are valid for this subject only"]


def test_sessions_with_other_filters_are_groups_of_their_own_and_compared_within_seeds(
    tmp_path: Path,
) -> None:
    for seed, (naive, latent) in enumerate([([True, False], [True, True])] * 3):
        session(tmp_path, f"naive_{seed}", naive, seed=seed)
        out = session(tmp_path, f"latent_{seed}", latent, seed=seed)
        note = json.loads((out / "run.json").read_text())
        note["params"]["estimator"] |= {"filter": "latent"}
        write_json(out / "run.json", note)
    record = pool(find_sessions(tmp_path))
    designs = sorted(one["design"].partition("; 2,")[0] for one in record["groups"])
    assert designs == ["markov; feature", "markov; feature, filter latent"]
    (difference,) = record["differences"]
    assert abs(difference["difference"]["value"]) == pytest.approx(0.5)


def test_excluded_trials_do_not_count_and_are_listed(tmp_path: Path) -> None:
    out = session(tmp_path, "one", [True, True, False, False])
    audit = (
        "phase,trial,deed,reason,time,user\nestimation,1002,exclude,slipped,t,u\n"
        'estimation,1003,redo,"late, twice",t,u\n'
    )
    (out / "audit.csv").write_text(audit + ",0,unseal,x,t,u\n", encoding="utf-8")
    (entry,) = find_sessions(tmp_path)
    assert entry.excluded == {
        ("estimation", 1002): "exclude: slipped",
        ("estimation", 1003): "redo: late, twice",
    }
    (group,) = pool([entry])["groups"]
    assert (group["trials"], group["excluded"], group["accuracy"]["value"]) == (2, 2, 1.0)
    assert any("excluded trials, each with its reason: 2" in words for words in remarks(pool([entry])))


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        ("estimation,x,exclude,y,t,u", "audit.csv:2: the line is damaged"),
        ("training,77,exclude,typo,t,u", "training trial 77 is excluded, and the record has none"),
    ],
)
def test_an_audit_that_does_not_fit_makes_the_session_damaged(tmp_path: Path, line: str, shown: str) -> None:
    audit = session(tmp_path, "one", [True]) / "audit.csv"
    audit.write_text(f"phase,trial,deed,reason,time,user\n{line}\n", encoding="utf-8")
    (entry,) = find_sessions(tmp_path)
    assert entry.state == "damaged"
    assert shown in entry.words


def test_a_copy_an_unfinished_and_an_unmeasured_session_do_not_count(tmp_path: Path) -> None:
    one = session(tmp_path, "one", [True, False], began="2026-11-22_10-00-00")
    shutil.copytree(one, tmp_path / "two")
    session(tmp_path, "stopped", [True], exit_code=1, began="2026-11-22_11-00-00")
    session(tmp_path, "untried", [], repeats=1, began="2026-11-22_12-00-00")
    record = pool(find_sessions(tmp_path))
    assert [Path(left["path"]).name for left in record["left_out"]] == ["two", "stopped", "untried"]
    assert [left["why"].partition(":")[0] for left in record["left_out"]][:2] == [
        f"a copy of {one}",
        "unfinished",
    ]
    assert record["groups"][0]["sessions"] == 1
    both = pool(find_sessions(tmp_path), unfinished=True)
    assert both["groups"][0]["sessions"] == 2


def test_sessions_that_were_run_otherwise_are_another_group_or_a_remark(tmp_path: Path) -> None:
    session(tmp_path, "one", [True, True], policy="markov")
    session(tmp_path, "two", [True, False], policy="uniform")
    out = session(tmp_path, "three", [True, False], policy="uniform")
    note = msgspec.json.decode((out / "run.json").read_bytes(), type=RunSummary)
    note.params["estimator"]["max_probes"] = 7
    write_json(out / "run.json", note)
    record = pool(find_sessions(tmp_path))
    assert sorted(one["design"].partition(";")[0] for one in record["groups"]) == ["markov", "uniform"]
    shown = [words for group in record["groups"] for words in group["remarks"]]
    assert shown == ["not all were run alike: estimator.max_probes: 15 | 7"]
    assert any("not compared" in words for words in remarks(record))


def test_groups_with_common_subjects_are_compared_within_them(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    for number in range(8):
        for policy, share in (("markov", 0.5), ("uniform", 0.9)):
            right = (rng.random(6) < share).tolist()
            session(tmp_path, f"{policy}-{number}", right, subject=f"S{number:02d}", policy=policy)
    record = pool(find_sessions(tmp_path))
    (one,) = record["differences"]
    by_policy = {group["design"].partition(";")[0]: group["accuracy_per_unit"] for group in record["groups"]}
    pairs = [by_policy["markov"][name] - by_policy["uniform"][name] for name in sorted(by_policy["markov"])]
    sign = 1.0 if one["first"].startswith("markov") else -1.0
    assert one["difference"]["value"] == pytest.approx(sign * float(np.mean(pairs)))
    assert one["difference"]["of"] == 8


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["session", "list", *map(str, arguments)])
    return result.exit_code, result.output


def test_the_command_lists_pools_and_writes_page_tables_and_json(tmp_path: Path) -> None:
    for number in range(4):
        session(tmp_path / "study", f"s{number}", [True, number > 1, True], subject=f"S0{number}")
    session(tmp_path / "study", "stopped", [True], exit_code=1)
    code, shown = run(tmp_path / "study", "--out", tmp_path / "out")
    assert code == 0, shown
    assert "4 subjects" in shown
    assert "unfinished: 1 of 6 trials" in shown
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {"index.html", "sessions.csv", "pooled.csv", "pooled.json"}
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert not list(flaws(page))
    assert "unfinished: 1 of 6 trials, because: Ctrl-C" in page
    code, shown = run(tmp_path / "study", "--json")
    assert json.loads(shown)["groups"][0]["units"] == 4


def test_the_command_ends_with_status_1_where_nothing_counts(tmp_path: Path) -> None:
    session(tmp_path, "stopped", [True], exit_code=1)
    code, shown = run(tmp_path)
    assert (code, "no session counts" in shown) == (1, True)


def test_palp_analyse_takes_a_folder_of_sessions(tmp_path: Path) -> None:
    for number in range(3):
        session(tmp_path / "study", f"s{number}", [True] * (3 + number), repeats=4)
    session(tmp_path / "study", "stopped", [True], exit_code=1)
    result = CliRunner().invoke(app, ["session", "reanalyse", str(tmp_path / "study"), "--json"])
    assert result.exit_code == 0, result.output
    assert "left out" in result.stderr
    assert [Path(one["path"]).name for one in json.loads(result.stdout)["sessions"]] == ["s0", "s1", "s2"]
