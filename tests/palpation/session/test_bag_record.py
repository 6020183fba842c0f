"""``palp session report BAG``: what a bag has of a session is what the session's folder says."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.errors import PalpError
from palp_core.graph.bag.edit import copy_messages, rewrite
from palp_core.graph.bag.reader import Bag, topic_selection
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.builtin import DiagnosticStatus
from palp_core.graph.messages.message import encode
from palp_core.graph.recording.provenance import LAUNCH_ATTACHMENT
from palp_core.palpation.session.bag_record import write_record
from palp_core.palpation.session.recorded_session import read_session
from palp_core.palpation.session.trials_csv import read_rows, read_sweep
from tests.support.bags import describe
from tests.support.rig_session import RigSession
from tests.support.sessions import Summariser, without_times

UNCOUNTED = {"activations"}


def report(*arguments: object) -> str:
    return CliRunner().invoke(app, ["session", "report", *map(str, arguments)], catch_exceptions=False).stdout


def result(folder: Path) -> dict[str, Any]:
    found = without_times(json.loads((folder / "result.json").read_text()))
    return {key: value for key, value in found.items() if key not in UNCOUNTED}


def same_record(one: Path, other: Path) -> None:
    for name in ("trials.csv", "primitives.json"):
        assert (one / name).read_bytes() == (other / name).read_bytes()
    assert result(one) == result(other)


@pytest.mark.usefixtures("blank_charts")
def test_a_bag_and_the_folder_of_its_run_give_the_same_session(
    rig_session: RigSession, tmp_path: Path
) -> None:
    again = tmp_path / "again"
    shown = report(rig_session.bag, "--out", again, "--charts")
    assert shown.endswith(f"result.json in {again}. Report: {again}/report.html\n")
    same_record(again, rig_session.out)
    for row in read_rows(again):
        ours, theirs = (read_sweep(folder, row.row) for folder in (again, rig_session.out))
        assert np.array_equal(ours[0], theirs[0])
        assert ours[1] == theirs[1]
    copy = Path(shutil.copytree(rig_session.out, tmp_path / "copy"))
    report(copy, "--charts")
    files, wanted = (sorted((folder / "charts").iterdir()) for folder in (again, copy))
    assert [path.name for path in files] == [path.name for path in wanted]
    assert len({path.suffix for path in files}) == 3
    numbers = [[path.read_bytes() for path in paths if path.suffix == ".csv"] for paths in (files, wanted)]
    assert numbers[0] == numbers[1]
    page = (again / "report.html").read_text()
    assert "unfinished" not in page
    assert "wall time" not in page
    before = (again / "result.json").read_bytes()
    report(again)
    assert (again / "result.json").read_bytes() == before


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_record_that_cannot_begin_advises_the_option_that_names_its_folder(
    rig_session: RigSession, tmp_path: Path, overwrite: bool
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(PalpError, match=r"choose another --out$"):
        write_record(rig_session.bag, tmp_path / "file" / "record", overwrite=overwrite)


def test_a_session_is_not_overwritten_unasked(rig_session: RigSession, tmp_path: Path) -> None:
    copy = shutil.copytree(rig_session.out, tmp_path / "copy")
    with pytest.raises(PalpError, match=r"holds a session already.*--out NAME.*--overwrite"):
        report(rig_session.bag, "--out", copy)


@pytest.mark.usefixtures("blank_charts")
def test_what_nodes_reported_as_wrong_is_in_the_result_with_its_time_in_the_bag(
    rig_session: RigSession, tmp_path: Path
) -> None:
    topic = "/safety/diagnostics"
    with Bag(rig_session.bag) as bag, BagWriter(tmp_path / "tripped") as writer:
        launch = json.loads(bag.attachments()[LAUNCH_ATTACHMENT])
        launch["publishes"]["safety"] = {topic: "DiagnosticStatus"}
        writer.attach(LAUNCH_ATTACHMENT, json.dumps(launch).encode())
        copy_messages(bag.recorded(), writer)
        stream = writer.stream(Stream(topic=describe(DiagnosticStatus, topic)))
        for sequence, level in enumerate(("ok", "error", "ok"), start=1):
            stamp_ns = sequence * 10**10
            status = DiagnosticStatus(stamp_ns=stamp_ns, level=level, text="tripped", advice="look")
            writer.write(stream, sequence, stamp_ns, stamp_ns, encode(status))
    report(tmp_path / "tripped")
    assert result(tmp_path / "tripped_report")["incidents"] == [
        {
            "node": "safety", "level": "error", "text": "tripped", "advice": "look", "at": "at 20.0 s",
            "at_s": 20.0, "until_s": 30.0,
        }
    ]  # fmt: skip


def part(session: RigSession, out: Path, **limits: Any) -> Path:
    rewrite([session.bag], out, **limits)
    return out


@pytest.mark.parametrize(("end_s", "of"), [(60, "30 palpations of training"), (340, "6 trials")])
@pytest.mark.usefixtures("blank_charts")
def test_a_bag_that_ends_early_gives_the_rows_until_then_and_says_so(
    rig_session: RigSession, tmp_path: Path, end_s: int, of: str
) -> None:
    cut = part(rig_session, tmp_path / "cut", end_ns=end_s * 10**9)
    shown, folder = report(cut), tmp_path / "cut_report"
    rows = read_rows(folder)
    assert 0 < len(rows) < len(read_rows(rig_session.out))
    assert rows == read_rows(rig_session.out)[: len(rows)]
    done = len(rows) if "training" in of else len(read_session(folder).trials)
    words = f"nfinished: {done} of {of}"
    assert shown.startswith(f"U{words}, because: the bag ends before the session does.")
    assert f"(u{words})" in (folder / "report.html").read_text()
    assert json.loads((folder / "result.json").read_text())["confusion"]["depths_mm"] == [2.0, 4.0, 8.0]


@pytest.mark.usefixtures("blank_charts")
def test_of_a_bag_that_was_cut_off_what_stands_before_is_reported(
    rig_session: RigSession, tmp_path: Path
) -> None:
    (whole,) = rig_session.bag.glob("*.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size * 2 // 3])
    assert "because: the bag is damaged: " in report(cut)
    rows = read_rows(tmp_path / "cut_report")
    assert rows == read_rows(rig_session.out)[: len(rows)] != []


@pytest.mark.usefixtures("blank_charts")
@pytest.mark.parametrize("start", ["in training", "after training"])
def test_a_bag_that_began_late_has_the_rows_from_then_on_and_says_what_it_lacks(
    rig_session: RigSession, tmp_path: Path, start: str
) -> None:
    every, folder, start_ns = read_rows(rig_session.out), tmp_path / "late_report", 100 * 10**9
    if start == "after training":
        start_ns = next(row for row in every if row.phase == "estimation").start_ns - 20 * 10**9
    shown = report(part(rig_session, tmp_path / "late", start_ns=start_ns))
    rows = read_rows(folder)
    lacking = len(every) - len(rows) if start == "in training" else 1
    assert f"the bag lacks at least {lacking} palpation" in shown
    assert [(row.trial, row.iteration, row.posterior) for row in rows] == [
        (row.trial, row.iteration, row.posterior) for row in every[-len(rows) :]
    ]
    assert {row.phase for row in rows} == {"estimation", *(["training"] if start == "in training" else [])}
    assert read_session(folder).depths_m == (0.002, 0.004, 0.008)


@pytest.mark.parametrize(
    ("left_out", "shown"),
    [
        ("belief", "nothing of /estimator/belief is in it, and without it there is no session"),
        ("palpation", "no palpation: /estimator/palpation is missing"),
        ("/actuator/", "nothing of /actuator/ring_state, /actuator/truth is in it"),
    ],
)
def test_a_bag_without_what_a_session_needs_is_refused_and_leaves_nothing(
    rig_session: RigSession, tmp_path: Path, left_out: str, shown: str
) -> None:
    some = part(rig_session, tmp_path / "some", select=topic_selection([], None, left_out))
    with pytest.raises(PalpError, match=shown):
        report(some)
    assert not (tmp_path / "some_report").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("blank_charts")
def test_whether_guards_were_recorded_follows_from_what_else_the_phantom_published(
    rig_session: RigSession, tmp_path: Path
) -> None:
    for name, left_out, recorded in (("a", "/guard", True), ("b", "/phantom/(guard|contact|_.*)", False)):
        bag = part(rig_session, tmp_path / name, select=topic_selection([], None, left_out))
        report(bag)
        found = json.loads((tmp_path / f"{name}_report" / "result.json").read_text())
        guards = found["mechanics"]["guards"]
        assert guards == ({code: [] for code in "ABC"} if recorded else None)


def test_what_is_no_bag_of_a_session_is_refused(
    rig_session: RigSession, tmp_path: Path, summary: Summariser
) -> None:
    run = msgspec.structs.replace(summary(tmp_path), publishes={"relay": {"/relay/out": "Amplified"}})
    with BagWriter(tmp_path / "other"), BagWriter(tmp_path / "bag") as writer:
        writer.attach(LAUNCH_ATTACHMENT, msgspec.json.encode(run))
    with pytest.raises(PalpError, match="written by another tool"):
        report(tmp_path / "other")
    with pytest.raises(PalpError, match="not a session"):
        report(tmp_path / "bag")
    with pytest.raises(PalpError, match="is not a bag"):
        report(rig_session.out, "--out", tmp_path / "x")
