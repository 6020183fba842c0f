"""The sheet of a session with a person: required where somebody is measured, and of that subject."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.errors import PalpError
from palp_core.graph.launch.checking import check_start
from tests.palpation.session.sheet.filled import FILLED
from tests.support.palp import ROOT
from tests.support.rig_session import check_here

HUMAN = ROOT / "launch/human.yaml"
BY_HAND = FILLED.partition("sensor:")[0]
PEOPLE = (("emg:=noraxon", "host:=192.168.1.20"), ("emg:=lsl",))


def start(tmp_path: Path, *given: str, sheet: str = "") -> None:
    """Ask whether a session may start."""
    (tmp_path / "sheet.yaml").write_text(sheet, encoding="utf-8")
    named = [f"session:={tmp_path / 'sheet.yaml'}"] if sheet else []
    check_start(HUMAN, check_here(HUMAN, [*given, *named, f"out:={tmp_path / 'out'}"]))


@pytest.mark.parametrize("given", PEOPLE, ids=lambda given: given[0])
def test_nobody_is_measured_without_a_sheet(given: tuple[str, ...], tmp_path: Path) -> None:
    with pytest.raises(PalpError, match=r"a session with a person needs its sheet.*new FILE --by-hand"):
        start(tmp_path, *given)
    start(tmp_path, *given, sheet=BY_HAND)


@pytest.mark.parametrize("given", ["emg:=simulated", "emg:=emulator"])
def test_where_nobody_is_measured_none_is_needed(given: str, tmp_path: Path) -> None:
    start(tmp_path, given)


@pytest.mark.parametrize(
    ("sheet", "given", "words"),
    [
        (BY_HAND.replace("subject: S01", "subject: none"), "", r":3:10: a person is measured: give the subj"),
        (BY_HAND.replace("17-204", "none"), "", "is measured under an approval"),
        (BY_HAND, "subject:=S02", "of another subject than subject:= says"),
        (BY_HAND.replace("  C:", "  D:"), "", "the run has no phantom 'D'"),
    ],
)
def test_a_sheet_that_does_not_fit_is_refused_in_words(
    sheet: str, given: str, words: str, tmp_path: Path
) -> None:
    with pytest.raises(PalpError, match=words):
        start(tmp_path, *PEOPLE[0], *filter(None, [given]), sheet=sheet)


def test_the_sheet_to_fill_in_asks_for_no_torque_sensor(tmp_path: Path) -> None:
    path = tmp_path / "S01.yaml"
    assert CliRunner().invoke(app, ["session", "new", str(path), "--by-hand"]).exit_code == 0
    assert "sensor" not in path.read_text()
    path.write_text(BY_HAND)
    assert "17-204" in CliRunner().invoke(app, ["session", "show", str(path), "--by-hand"]).stdout
    assert CliRunner().invoke(app, ["session", "show", str(path)]).exit_code != 0
