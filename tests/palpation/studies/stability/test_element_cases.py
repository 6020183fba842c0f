"""The stability table's rows of finite elements fail where it says; the functions have their own tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from palp_core.palpation.studies.stability import cases_fem
from palp_core.palpation.studies.stability.cases_joint import joint_cases
from palp_core.palpation.studies.stability.cases_other import other_cases
from palp_core.palpation.studies.stability.study import markdown

DOCS = Path(__file__).parents[4] / "docs" / "mechanics.md"


def test_explicit_elements_need_tens_of_thousands_of_steps_at_any_poissons_ratio() -> None:
    case = cases_fem._explicit(quick=True)
    assert case.failed.all()
    assert case.survived


@pytest.mark.slow
def test_the_whole_map_in_the_documentation_is_the_studys() -> None:
    cases = [*joint_cases(quick=False), *other_cases(quick=False), *cases_fem.fem_cases(quick=False)]
    assert markdown(cases) in DOCS.read_text(encoding="utf-8")


@pytest.mark.slow
def test_each_case_fails_somewhere_and_its_survivor_nowhere() -> None:
    cases = cases_fem.fem_cases(quick=True)
    assert {case.name for case in cases} == {
        "linear_triangles",
        "iterative_solver",
        "truncated_block",
        "coarse_cells",
        "explicit_elements",
        "small_strain",
    }
    for case in cases:
        assert case.failed.any(), case.name
        assert case.survived, case.name
