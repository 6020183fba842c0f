"""The stability map's rows of finite elements fail where it says; the functions have their own tests."""

from __future__ import annotations

import pytest

from palp_core.studies import contact_cases_fem


def test_explicit_elements_need_tens_of_thousands_of_steps_at_any_poissons_ratio() -> None:
    case = contact_cases_fem._explicit(quick=True)
    assert case.failed.all()
    assert case.survived


@pytest.mark.slow
def test_each_case_fails_somewhere_and_its_survivor_nowhere() -> None:
    cases = contact_cases_fem.fem_cases(quick=True)
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
