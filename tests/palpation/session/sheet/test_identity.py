"""Codes pass, names do not, and no refusal repeats what was typed."""

from __future__ import annotations

import pytest

from palp_core.errors import PalpError
from palp_core.palpation.session.sheet.identity import consent_id, subject_code


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
