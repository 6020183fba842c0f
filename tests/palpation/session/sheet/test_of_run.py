"""The sheet of a run: required on the rig, defaulted in simulation, in the report and what is recorded."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.errors import PalpError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.launch.checking import check_start
from palp_core.graph.launch.summary import RunSummary
from palp_core.palpation.session.bag_record import launch_of
from palp_core.palpation.session.report import session
from palp_core.palpation.session.run_note import read_note
from palp_core.palpation.session.sheet.of_run import asked_sheet, sheet_of
from tests.palpation.session.sheet.filled import FILLED
from tests.support.palp import ROOT
from tests.support.rig_session import RigSession, check_here
from tests.support.sessions import describe, writer

Writer = Callable[..., Path]
pytestmark = pytest.mark.usefixtures("blank_charts")


def with_sheet(summary: RunSummary, path: str) -> RunSummary:
    params = {**summary.params, "experiment": {**summary.params["experiment"], "session": path}}
    return msgspec.structs.replace(summary, params=params, args={**summary.args, "session": path})


def on_the_rig(summary: RunSummary) -> RunSummary:
    publishes = {**summary.publishes, "phantom": {"/phantom/truth": "PhantomTruth"}}
    return msgspec.structs.replace(summary, publishes=publishes, clock="wall")


@pytest.fixture
def sheet(tmp_path: Path) -> str:
    (tmp_path / "sheet.yaml").write_text(FILLED, encoding="utf-8")
    return str(tmp_path / "sheet.yaml")


def test_the_rig_refuses_to_start_without_a_sheet_and_says_how_to_get_one() -> None:
    file = ROOT / "launch" / "rig.yaml"
    with pytest.raises(PalpError, match=r"rig\.yaml: a session on the rig needs its sheet.*palp session new"):
        check_start(file, check_here(file))


def test_the_rig_starts_with_a_sheet_and_says_each_mistake_with_its_line(tmp_path: Path, sheet: str) -> None:
    file = ROOT / "launch" / "rig.yaml"
    check_start(file, check_here(file, [f"session:={sheet}", f"out:={tmp_path / 'o'}"]))
    Path(sheet).write_text(FILLED.replace("operator: ÅB", "operator:"), encoding="utf-8")
    with pytest.raises(PalpError, match=r"sheet\.yaml:2:10: 'operator' is still to be filled in"):
        check_start(file, check_here(file, [f"session:={sheet}", f"out:={tmp_path / 'o'}"]))


@pytest.mark.parametrize("file", ["sim.yaml", "emulated.yaml"])
def test_what_is_simulated_starts_without_one(file: str, tmp_path: Path) -> None:
    check_start(ROOT / "launch" / file, check_here(ROOT / "launch" / file, [f"out:={tmp_path / 'o'}"]))


def test_a_simulated_session_has_a_sheet_that_says_so(tmp_path: Path) -> None:
    found = asked_sheet(describe(tmp_path))
    assert found.simulated
    assert (found.lab, found.subject, found.ethics) == ("simulation", "none", "none")
    assert found.software["palp"]


def test_a_real_touch_is_not_called_simulated(tmp_path: Path, sheet: str) -> None:
    real = on_the_rig(describe(tmp_path))
    with pytest.raises(PalpError, match="needs its sheet"):
        asked_sheet(real)
    assert not asked_sheet(with_sheet(real, sheet)).simulated


def test_result_page_and_folder_say_what_the_sheet_says(tmp_path: Path, sheet: str) -> None:
    out = writer(tmp_path)(trials=[(0, [[0.8, 0.1, 0.1]])])
    summary = with_sheet(describe(out), sheet)
    session(msgspec.structs.replace(summary, attached=session.attach(summary)))
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert result["session"]["subject"] == "S01"
    assert result["session"]["phantoms"]["B"]["batch"] == "12"
    assert result["session"]["sensor"] == {"serial": "FT0123", "bias_n_m": -0.0015}
    assert result["began"]
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "<td>ÅB</td>" in page
    assert "P7, batch 12, cured 2026-03-01 at 23 °C" in page
    assert "operator: ÅB" in (out / "session.yaml").read_text(encoding="utf-8")
    found = sheet_of(read_note(out))
    assert found is not None
    assert found.note == "mounted twice"


def test_a_session_of_an_earlier_palp_has_none_and_a_report(tmp_path: Path) -> None:
    session(describe(out := writer(tmp_path)(trials=[(0, [[0.8, 0.1, 0.1]])])))
    assert json.loads((out / "result.json").read_text(encoding="utf-8"))["session"] is None
    assert not (out / "session.yaml").exists()


def test_a_sheet_of_ones_own_in_the_sessions_folder_is_not_replaced(tmp_path: Path) -> None:
    out = tmp_path / "S01"
    out.mkdir()
    (out / "session.yaml").write_text(FILLED, encoding="utf-8")
    with pytest.raises(PalpError, match="would take its place"):
        session.prepare(describe(out))
    assert (out / "session.yaml").read_text(encoding="utf-8") == FILLED


def test_folder_and_bag_of_a_run_hold_the_same_sheet(rig_session: RigSession) -> None:
    with Bag(rig_session.bag) as bag:
        recorded = sheet_of(launch_of(bag))
    assert recorded is not None
    assert recorded.simulated
    assert recorded.began
    assert recorded == sheet_of(read_note(rig_session.out))


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["session", *map(str, arguments)])
    return result.exit_code, result.output + str(result.exception or "")


def test_the_template_is_written_once_and_shown_with_what_it_lacks(tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    assert run("new", file)[0] == 0
    code, said = run("show", file)
    assert code != 0
    assert f"{file}:3:" in said
    assert "there already" in run("new", file)[1]


def test_a_sheet_is_shown_of_file_folder_and_bag(sheet: str, rig_session: RigSession) -> None:
    code, said = run("show", sheet)
    assert code == 0
    assert "S01" in said
    for path in (rig_session.out, rig_session.bag):
        code, said = run("show", path)
        assert code == 0
        assert "simulation" in said
        assert json.loads(run("show", path, "--json")[1])["simulated"] is True
