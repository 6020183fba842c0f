"""``palp methods why``: what a run used and why, from its folder, its bag and while it runs."""

from __future__ import annotations

import json
import re
import shutil
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from typer.testing import CliRunner

from palp_core.cli import running
from palp_core.cli.main import app
from palp_core.errors import PalpError
from palp_core.graph.launch.checking import check_file
from palp_core.graph.launch.graph import Graph
from palp_core.graph.launch.summary import summary_of
from palp_core.graph.messages.builtin import Progress
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import decode
from palp_core.methods import find
from palp_core.palpation.reporting import charts
from palp_core.palpation.session import bag_record
from palp_core.palpation.session.report import write
from palp_core.palpation.session.run_note import read_note
from palp_core.palpation.session.trials_csv import read_rows
from tests.support.palp import CHAIN, SIM
from tests.support.rig_session import ComposedGraph, RigSession

PHANTOMS = "A: {bead: {depth_m: 0.002}}\nB: {bead: {depth_m: 0.004}}\nC: {bead: {depth_m: 0.008}}\n"


def printed(*arguments: object) -> str:
    done = CliRunner().invoke(app, ["methods", "why", *map(str, arguments)], catch_exceptions=False)
    assert done.exit_code == 0
    return done.stdout


def shown(*arguments: object) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(printed(*arguments, "--json"))
    return found


def of_task(record: list[dict[str, Any]], task: str) -> list[dict[str, Any]]:
    return [one for one in record if one["task"] == task]


class Asked:
    """Does something during a composed graph's run when a phase begins or ends, as another process would."""

    def __init__(self, **at_phase: Callable[[], None]) -> None:
        self._at_phase = at_phase
        self.graph: Graph | None = None

    @property
    def run(self) -> str:
        """What the running graph is named by."""
        assert self.graph is not None
        return self.graph.directory.path.name

    def __call__(self, _: int, frame: bytes) -> None:
        parsed = parse(frame)
        if parsed.topic != "/experiment/progress" or self.graph is None:
            return
        action = self._at_phase.pop(decode(Progress, parsed.payload).phase, None)
        if action is not None:
            asking = threading.Thread(target=action)
            asking.start()
            while asking.is_alive():
                self.graph.launcher_node.poll()
            asking.join()


def test_folder_bag_and_running_graph_report_the_same_with_swap_and_changed_parameters(
    tmp_path: Path,
) -> None:
    (tmp_path / "three.yaml").write_text(PHANTOMS, encoding="utf-8")
    live: list[list[dict[str, Any]]] = []
    asked = Asked(done=lambda: live.extend([shown(asked.run), shown(tmp_path / "out")]))
    given = [
        f"out:={tmp_path / 'out'}",
        f"phantoms:={tmp_path / 'three.yaml'}",
        "rings_mm:=0, 16",
        "policy:=fixed",
        "trials:=1",
        "training:=2",
        "swaps:=3=nodes.policy_information:Information",
    ]
    with ComposedGraph(SIM, record=tmp_path / "bag", observe=asked, overrides=given) as graph:
        asked.graph = graph
        graph.run()
    folder = shown(tmp_path / "out")
    assert [folder, folder] == [shown(tmp_path / "bag"), live[0]]
    assert live[1] == folder  # of a run that goes on its folder is asked for by the graph
    result = json.loads((tmp_path / "out/result.json").read_text())
    assert folder == result["methods"]

    rungs = of_task(folder, "contact")
    assert [(one["of"], one["method"], one["how"]) for one in rungs] == [
        (code, "l2", "chosen") for code in "ABC"
    ]
    assert all(one["bound"] <= one["tolerance"] and one["evidence"] for one in rungs)
    first, second = of_task(folder, "policy")
    assert (first["method"], second["method"]) == ("fixed", "information_gain_latent")
    assert first["until_s"] == second["from_s"]
    rows = read_rows(tmp_path / "out")
    trials = sorted({row.trial for row in rows if row.phase == "estimation"})
    swapped = next(row for row in rows if row.trial == trials[2] and row.start_ns / 1e9 > second["from_s"])
    assert swapped.iteration == 2
    assert [one["method"] for one in of_task(folder, "motion")] == ["quasi_static"]


def test_each_task_says_what_was_used_and_a_person_reads_it(rig_session: RigSession) -> None:
    record = shown(rig_session.out)
    assert [one["task"] for one in record] == [
        *("contact", "contact", "contact", "motion", "denoise", "feature", "likelihood"),
        *("filter", "stop", "policy"),
    ]
    for one in record:
        assert one["evidence"] == find(one["task"], one["method"]).evidence
    text = printed(rig_session.out)
    for line in (
        "contact of A: l2 (/phantom)\n    chosen: the cheapest that gives 'peak' within 2.0%",
        "stop: paper_guarded (/estimator)\n    asked for by name",
        "(/phantom)\n    the only one that a launched run has; wanted: 'peak'",
        "cheaper: l0 (not available here: a reference",
    ):
        assert line in text
    named = {one["task"] for one in record if one["how"] == "asked for by name"}
    assert named == {"denoise", "feature", "likelihood", "filter", "stop", "policy"}  # by the launch file
    assert [one["how"] for one in record if one["task"] == "contact"] == ["chosen"] * 3
    marked = {(one["of"], text): n for one in record for text, n in (one["guards"] or {}).items()}
    rows = read_rows(rig_session.out)
    assert marked == Counter((row.phantom, text) for row in rows for text in row.guards)
    assert any(text.startswith("small strain") for _, text in marked)
    page = (rig_session.out / "report.html").read_text()
    assert "Why these methods" in page
    assert "stop: paper_guarded (/estimator)" in page


def test_a_run_that_is_not_whole_says_so(rig_session: RigSession, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (whole,) = rig_session.bag.glob("*.mcap")
    (bag / whole.name).write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    cut = CliRunner().invoke(app, ["methods", "why", str(bag)], catch_exceptions=False)
    assert re.search(r"not the whole run: the bag is damaged: .*; this is of the \d+ palpations", cut.stderr)
    assert CliRunner().invoke(app, ["methods", "why", str(rig_session.bag)]).stderr == ""
    killed = tmp_path / "killed"
    shutil.copytree(rig_session.out, killed)
    note = json.loads((killed / "run.json").read_text()) | {
        "exit_code": -1,
        "ended": "unknown",
        "methods": [],
    }
    (killed / "run.json").write_text(json.dumps(note))
    words = CliRunner().invoke(app, ["methods", "why", str(killed)], catch_exceptions=False).stderr
    assert "not the whole run: unknown" in words
    assert "which methods the policy used is not recorded" in words


def test_the_mechanics_of_a_report_are_what_the_run_used_though_its_file_is_another_by_now(
    rig_session: RigSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(charts, "image", lambda *_: b"")
    kept = tmp_path / "kept"
    shutil.copytree(rig_session.out, kept)
    note = (kept / "run.json").read_text()
    other = tmp_path / "other.yaml"
    other.write_text("phantom: {modulus_pa: 5000.0}\n", encoding="utf-8")
    before = json.loads((kept / "result.json").read_text())
    parsed = json.loads(note)
    parsed["params"]["phantom"]["scene"] = str(other)
    (kept / "run.json").write_text(json.dumps(parsed), encoding="utf-8")
    write(kept, read_note(kept))
    after = json.loads((kept / "result.json").read_text())
    moduli = [one["mechanics"]["scene"]["A"]["modulus_pa"]["value"] for one in (before, after)]
    assert moduli == [20e3, 20e3]
    assert after["methods"] == before["methods"]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (".", "is neither a session's folder (run.json is missing) nor a bag"),
        ("file", "is neither a session's folder (run.json is missing) nor a bag"),
        ("no-such-run", "is no folder of a session, no bag and no running graph"),
        ("", "name a session's folder or a bag: palp methods why results/latest"),
    ],
)
def test_what_is_no_run_is_refused(
    name: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(PalpError) as refused:
        CliRunner().invoke(app, ["methods", "why", *([name] if name else [])], catch_exceptions=False)
    assert words in str(refused.value)


def test_a_bag_or_a_running_graph_without_a_rig_is_refused(
    rig_session: RigSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    chain = summary_of(check_file(CHAIN), CHAIN)
    monkeypatch.setattr(bag_record, "launch_of", lambda _: chain)
    summary = {"summary": msgspec.to_builtins(chain)}
    monkeypatch.setattr(running, "find_graph", lambda _: SimpleNamespace(ask=lambda *_: summary))
    for run, words in (
        (
            str(rig_session.bag),
            "not a session: graph 'chain' has no palpations and no methods",
        ),
        ("chain", "graph 'chain' runs, but is no session: .*no node publishes TrialResult"),
    ):
        with pytest.raises(PalpError, match=words):
            CliRunner().invoke(app, ["methods", "why", run], catch_exceptions=False)
