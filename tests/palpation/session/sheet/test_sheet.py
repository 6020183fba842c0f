"""``session.yaml``: what is missing, unfilled or wrong is shown with its line, all of it at once.

A run needs one where somebody or something real is measured; report, folder and bag have it. Codes pass,
names do not, and no refusal repeats what was typed.
"""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.errors import PalpError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.launch.checking import check_start
from palp_core.graph.launch.summary import RunSummary
from palp_core.graph.problems import GraphProblems
from palp_core.palpation.session.bag_record import launch_of
from palp_core.palpation.session.report import session
from palp_core.palpation.session.run_note import read_note
from palp_core.palpation.session.sheet.identity import consent_id, subject_code
from palp_core.palpation.session.sheet.of_run import asked_sheet, sheet_of
from palp_core.palpation.session.sheet.sheet import (
    MEANING,
    SIMULATED,
    PhantomEntry,
    SensorEntry,
    parse_copy,
    read_sheet,
    sheet_text,
    template,
)
from tests.support.palp import ROOT
from tests.support.rig_session import RigSession, check_here
from tests.support.sessions import describe, writer

FILLED = """\
lab: Motor Lab, 2nd floor
operator: ÅB
subject: S01
ethics: 17-204
phantoms:
  A: {id: P6, batch: 12, cured: 2026-02-28, cure_temperature_c: 22.5}
  B: {id: P7, batch: 12, cured: 2026-03-01, cure_temperature_c: 23}
  C: {id: P8, batch: 13, cured: 2026-03-02, cure_temperature_c: 23}
sensor:
  serial: FT0123
  bias_n_m: -1.5e-3
note: mounted twice
"""
BY_HAND = FILLED.partition("sensor:")[0]
PEOPLE = (("emg:=noraxon", "host:=192.168.1.20"), ("emg:=lsl",))
pytestmark = pytest.mark.usefixtures("blank_charts")


@pytest.fixture
def sheet(tmp_path: Path) -> Path:
    (tmp_path / "sheet.yaml").write_text(FILLED, encoding="utf-8")
    return tmp_path / "sheet.yaml"


def mistakes(folder: Path, text: str, codes: str = "ABC") -> dict[int, str]:
    path = folder / "session.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(GraphProblems) as caught:
        read_sheet(path, codes)
    assert {Path(one.file) for one in caught.value.problems} == {path}
    return {one.line: one.message for one in caught.value.problems}


def line_of(text: str, words: str) -> int:
    return next(i for i, line in enumerate(text.splitlines(), 1) if words in line)


def test_a_sheet_that_is_filled_in_says_what_was_written_and_so_does_its_copy(sheet: Path) -> None:
    found = read_sheet(sheet, "ABC")
    assert (found.lab, found.operator, found.subject) == ("Motor Lab, 2nd floor", "ÅB", "S01")
    assert (found.ethics, found.note) == ("17-204", "mounted twice")
    made = PhantomEntry(id="P7", batch="12", cured="2026-03-01", cure_temperature_c=23.0)
    assert found.phantoms["B"] == made
    assert found.sensor == SensorEntry(serial="FT0123", bias_n_m=-0.0015)
    taken = msgspec.structs.replace(
        found, software={"palp": "1"}, began="2026-11-23_10-00-00", simulated=True
    )
    for one in (taken, SIMULATED):
        assert parse_copy(sheet_text(one), "copy") == one
    sheet.write_text(sheet_text(taken), encoding="utf-8")
    assert read_sheet(sheet) == found
    for text in ("lab: [", "lab: 1\n", "nothing"):
        with pytest.raises(PalpError, match="x: the session's sheet is damaged"):
            parse_copy(text, "x")


def test_every_line_of_the_template_has_a_meaning_and_is_to_be_filled_in(tmp_path: Path) -> None:
    text = template("AB")
    keys = {line.split(":")[0].strip() for line in text.splitlines() if not line.startswith("#")}
    assert keys - {"A", "B"} == {name.rpartition(".")[2] for name in MEANING}
    found = mistakes(tmp_path, text, "AB")
    for name in ("lab", "operator", "subject", "ethics", "serial", "bias_n_m"):
        assert "still to be filled in" in found[line_of(text, f"{name}:")]
    assert sum("still to be filled in" in words for words in found.values()) == len(found) == 4 + 2 * 4 + 2


@pytest.mark.parametrize(
    ("was", "becomes", "shown"),
    [
        ("operator: ÅB", "operater: ÅB", "did you mean 'operator'?"),
        ("subject: S01", "subject: Anna Smith", "the subject's code has blanks"),
        ("subject: S01", "subject: anna1", "looks like a name"),
        ("subject: S01", "subject: ''", "still to be filled in"),
        ("ethics: 17-204", "ethics: none", "a subject (S01) is measured under an approval"),
        ("  B: {", "  D: {", "the run has no phantom 'D'"),
        ("cured: 2026-03-01", "cured: 1.3.2026", "is no day; write it as 2026-03-01"),
        ("cure_temperature_c: 23", "cure_temperature_c: warm", "is a number from -50 to 200"),
        ("cure_temperature_c: 23", "cure_temperature_c: .nan", "is a number from -50 to 200"),
        ("bias_n_m: -1.5e-3", "bias_n_m: true", "is a number from -10 to 10"),
        ("serial: FT0123", "serial: [FT0123]", "'serial' is one text"),
        ("lab: Motor Lab, 2nd floor", "lab: a\nlab: b", "is given twice"),
    ],
)
def test_a_mistake_is_shown_with_its_line(tmp_path: Path, was: str, becomes: str, shown: str) -> None:
    assert was in FILLED
    text = FILLED.replace(was, becomes, 1)
    found = mistakes(tmp_path, text)
    assert shown in found[line_of(text, becomes.splitlines()[-1])]


@pytest.mark.parametrize("text", ["", "- a\n- b\n", "lab: x\n", "phantoms: A\n", "lab: [\n", "sensor:\n"])
def test_what_is_no_sheet_is_refused_in_words(tmp_path: Path, text: str) -> None:
    assert mistakes(tmp_path, text)
    assert "lacks 'D'" in mistakes(tmp_path, FILLED, "ABCD")[line_of(FILLED, "phantoms:")]
    with pytest.raises(PalpError, match="palp session new"):
        read_sheet(tmp_path / "no.yaml")


def start(file: str, folder: Path, *given: str, sheet: str = "") -> None:
    """Ask whether a launch file may start."""
    (folder / "given.yaml").write_text(sheet, encoding="utf-8")
    named = [f"session:={folder / 'given.yaml'}"] if sheet else []
    path = ROOT / "launch" / file
    check_start(path, check_here(path, [*given, *named, f"out:={folder / 'out'}"]))


@pytest.mark.parametrize(
    ("file", "given"),
    [("sim.yaml", ()), ("emulated.yaml", ()), ("human.yaml", ("emg:=simulated",)), ("human.yaml", ())],
)
def test_what_is_simulated_starts_without_a_sheet(file: str, given: tuple[str, ...], tmp_path: Path) -> None:
    start(file, tmp_path, *given)


@pytest.mark.parametrize(
    ("file", "given", "filled", "how"),
    [
        ("rig.yaml", (), FILLED, r"a session on the rig needs its sheet.*palp session new FILE"),
        *(("human.yaml", of, BY_HAND, r"a person needs its sheet.*new FILE --by-hand") for of in PEOPLE),
    ],
)
def test_who_or_what_is_measured_needs_a_sheet(
    file: str, given: tuple[str, ...], filled: str, how: str, tmp_path: Path
) -> None:
    with pytest.raises(PalpError, match=how):
        start(file, tmp_path, *given)
    start(file, tmp_path, *given, sheet=filled)


@pytest.mark.parametrize(
    ("file", "given", "sheet", "words"),
    [
        ("rig.yaml", (), FILLED.replace("ÅB", ""), r"yaml:2:10: 'operator' is still to be filled in"),
        (
            "human.yaml",
            PEOPLE[0],
            BY_HAND.replace("S01", "none"),
            r":3:10: a person is measured: give the subj",
        ),
        ("human.yaml", PEOPLE[0], BY_HAND.replace("17-204", "none"), "is measured under an approval"),
        ("human.yaml", (*PEOPLE[0], "subject:=S02"), BY_HAND, "names another subject than subject:="),
        ("human.yaml", PEOPLE[0], BY_HAND.replace("  C:", "  D:"), "the run has no phantom 'D'"),
    ],
)
def test_a_sheet_that_does_not_fit_is_refused(
    file: str, given: tuple[str, ...], sheet: str, words: str, tmp_path: Path
) -> None:
    with pytest.raises(PalpError, match=words):
        start(file, tmp_path, *given, sheet=sheet)


def with_sheet(summary: RunSummary, path: Path) -> RunSummary:
    params = {**summary.params, "experiment": {**summary.params["experiment"], "session": str(path)}}
    return msgspec.structs.replace(summary, params=params)


def test_a_sheet_says_whether_the_touch_was_simulated(tmp_path: Path, sheet: Path) -> None:
    found = asked_sheet(describe(tmp_path))
    assert found.simulated
    assert (found.lab, found.subject, found.ethics) == ("simulation", "none", "none")
    assert found.software["palp"]
    publishes = {**describe(tmp_path).publishes, "phantom": {"/phantom/truth": "PhantomTruth"}}
    real = msgspec.structs.replace(describe(tmp_path), publishes=publishes, clock="wall")
    assert not asked_sheet(with_sheet(real, sheet)).simulated


def test_result_page_and_folder_say_what_the_sheet_says(tmp_path: Path, sheet: Path) -> None:
    out = writer(tmp_path)(trials=[(0, [[0.8, 0.1, 0.1]])])
    session(describe(out))
    assert json.loads((out / "result.json").read_text(encoding="utf-8"))["session"] is None
    assert not (out / "session.yaml").exists()
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


def test_a_sheet_of_ones_own_in_the_sessions_folder_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "session.yaml").write_text(FILLED, encoding="utf-8")
    with pytest.raises(PalpError, match="would take its place"):
        session.prepare(describe(tmp_path))
    assert (tmp_path / "session.yaml").read_text(encoding="utf-8") == FILLED


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["session", *map(str, arguments)])
    return result.exit_code, result.output + str(result.exception or "")


def test_the_template_is_written_once_and_shown_with_what_it_lacks(tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    assert run("new", file)[0] == 0
    code, shown = run("show", file)
    assert code != 0
    assert f"{file}:3:" in shown
    assert "there already" in run("new", file)[1]
    assert run("new", file, "--by-hand", "--overwrite")[0] == 0
    assert "sensor" not in file.read_text()
    file.write_text(BY_HAND)
    assert "17-204" in run("show", file, "--by-hand")[1]
    assert run("show", file)[0] != 0


def test_a_sheet_is_shown_of_file_folder_and_bag_and_both_have_the_same(
    sheet: Path, rig_session: RigSession
) -> None:
    assert "S01" in run("show", sheet)[1]
    for path in (rig_session.out, rig_session.bag):
        assert "simulation" in run("show", path)[1]
        assert json.loads(run("show", path, "--json")[1])["simulated"] is True
    with Bag(rig_session.bag) as bag:
        recorded = sheet_of(launch_of(bag))
    assert recorded is not None
    assert recorded.began
    assert recorded == sheet_of(read_note(rig_session.out))


@pytest.mark.parametrize("code", ["S01", "P-07", "sub-03", "VP_12", "7", "pilot2", " S01 ", "A1.2", "S1/2"])
def test_a_code_passes_and_names_no_other_folder(code: str) -> None:
    assert subject_code(code) == code.strip().replace("/", "-")


@pytest.mark.parametrize(
    "name",
    [
        *("", "   ", "Anna", "anna mueller", "Anna1", "Müller", "O'Neill", "AM", "Li", "anna.m@kcl.ac.uk"),
        *("19820314", "14-03-1982", "1982.3.14", "+44 20 7836 5454", "Bob_2", "S01 Anna", "S" * 40, "Ann-01"),
        *("../S01", "/S01", ".S01"),
    ],
)
def test_what_may_be_a_person_is_refused_and_not_repeated(name: str) -> None:
    with pytest.raises(PalpError, match="use a code as S01") as refused:
        subject_code(name)
    assert not name.strip() or name.strip() not in str(refused.value).replace("S01 or P-07", "")


def test_a_consent_form_has_an_id_which_may_have_a_date() -> None:
    assert consent_id("LRS-14/15-0703") == "LRS-14/15-0703"
    assert consent_id("IRB-20240113-7") == "IRB-20240113-7"
    for name in ("", "signed", "Anna Mueller 3", "Mueller-3"):
        with pytest.raises(PalpError):
            consent_id(name)
