"""``session.yaml``: what is missing, unfilled or wrong is told with its line, all of it at once."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from palp_core.errors import PalpError
from palp_core.graph.problems import GraphProblems
from palp_core.palpation.session.sheet.sheet import SIMULATED, PhantomEntry, SensorEntry
from palp_core.palpation.session.sheet.sheet_file import MEANING, parse_copy, read_sheet, sheet_text
from palp_core.palpation.session.sheet.template import template
from tests.palpation.session.sheet.filled import FILLED


def mistakes(folder: Path, text: str, codes: str = "ABC") -> dict[int, str]:
    path = folder / "session.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(GraphProblems) as caught:
        read_sheet(path, codes)
    assert {Path(one.file) for one in caught.value.problems} == {path}
    return {one.line: one.message for one in caught.value.problems}


def line_of(text: str, words: str) -> int:
    return next(i for i, line in enumerate(text.splitlines(), 1) if words in line)


def test_a_sheet_that_is_filled_in_says_what_was_written(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(FILLED, encoding="utf-8")
    sheet = read_sheet(tmp_path / "s.yaml", "ABC")
    assert (sheet.lab, sheet.operator, sheet.subject, sheet.ethics) == (
        "Motor Lab, 2nd floor",
        "ÅB",
        "S01",
        "17-204",
    )
    assert sheet.phantoms["B"] == PhantomEntry(
        id="P7", batch="12", cured="2026-03-01", cure_temperature_c=23.0
    )
    assert sheet.sensor == SensorEntry(serial="FT0123", bias_n_m=-0.0015)
    assert sheet.note == "mounted twice"


def test_every_line_of_the_template_is_to_be_filled_in(tmp_path: Path) -> None:
    text = template("AB")
    found = mistakes(tmp_path, text, "AB")
    for name in ("lab", "operator", "subject", "ethics", "serial", "bias_n_m"):
        assert "still to be filled in" in found[line_of(text, f"{name}:")]
    assert sum("still to be filled in" in words for words in found.values()) == len(found) == 4 + 2 * 4 + 2


@pytest.mark.parametrize(
    ("was", "becomes", "said"),
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
def test_a_mistake_is_told_with_its_line(tmp_path: Path, was: str, becomes: str, said: str) -> None:
    assert was in FILLED
    text = FILLED.replace(was, becomes, 1)
    found = mistakes(tmp_path, text)
    assert said in found[line_of(text, becomes.splitlines()[-1])]


@pytest.mark.parametrize("text", ["", "- a\n- b\n", "lab: x\n", "phantoms: A\n", "lab: [\n", "sensor:\n"])
def test_what_is_no_sheet_is_refused_in_words(tmp_path: Path, text: str) -> None:
    assert mistakes(tmp_path, text)


def test_a_phantom_that_the_run_uses_is_not_to_be_missing(tmp_path: Path) -> None:
    assert "lacks 'D'" in mistakes(tmp_path, FILLED, "ABCD")[line_of(FILLED, "phantoms:")]


def test_a_file_that_is_not_there_is_told_with_the_way_on(tmp_path: Path) -> None:
    with pytest.raises(PalpError, match="palp session new"):
        read_sheet(tmp_path / "no.yaml")


def test_a_copy_says_what_the_sheet_said_and_is_a_sheet_again(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(FILLED, encoding="utf-8")
    sheet = read_sheet(tmp_path / "s.yaml")
    taken = msgspec.structs.replace(
        sheet, software={"palp": "1"}, began="2026-11-23_10-00-00", simulated=True
    )
    assert parse_copy(sheet_text(taken), "copy") == taken
    assert parse_copy(sheet_text(SIMULATED), "copy") == SIMULATED
    (tmp_path / "copy.yaml").write_text(sheet_text(taken), encoding="utf-8")
    assert read_sheet(tmp_path / "copy.yaml") == sheet


@pytest.mark.parametrize("text", ["lab: [", "lab: 1\n", "nothing"])
def test_a_damaged_copy_is_named(text: str) -> None:
    with pytest.raises(PalpError, match="x: the session's sheet is damaged"):
        parse_copy(text, "x")


def test_each_key_of_the_template_has_a_meaning() -> None:
    keys = {line.split(":")[0].strip() for line in template("A").splitlines() if not line.startswith("#")}
    assert keys - {"A"} == {name.rpartition(".")[2] for name in MEANING}
