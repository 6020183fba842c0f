"""Every claim of the register can be looked up: evidence that exists, failures with what survives them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from palp_core.methods import Method, find, methods, tasks
from palp_core.palpation.studies.catalogue import STUDIES

ROOT = Path(__file__).parents[2]
EVERY = [one for task in tasks() for one in methods(task.name)]
OWN = [one for one in EVERY if one.module.startswith("palp_core.")]

_FILE = re.compile(r"\b(?:tests|benchmarks)/[\w./-]+\.py")
_STUDY = re.compile(r"palp study run ([\w-]+)")


def idents(every: list[Method]) -> list[str]:
    return [f"{one.task}:{one.name}" for one in every]


def test_the_register_holds_what_palp_is_made_of() -> None:
    """And these tests look at something."""
    assert {"contact", "equilibrium", "friction", "motion", "feature", "filter", "stop", "policy"} <= {
        one.task for one in OWN
    }


def unfounded(one: Method) -> str:
    """Return what of a method's evidence cannot be looked up, in words; "" if all of it can."""
    files, studies = _FILE.findall(one.evidence), _STUDY.findall(one.evidence)
    if not files and not studies:
        return f"'{one.evidence}' names no file of tests or benchmarks and no study"
    missing = [name for name in files if not (ROOT / name).is_file()]
    missing += [f"palp study run {name}" for name in studies if name not in STUDIES]
    return f"{', '.join(missing)}: there is none" if missing else ""


@pytest.mark.parametrize("one", OWN, ids=idents(OWN))
def test_the_evidence_of_a_method_exists(one: Method) -> None:
    assert unfounded(one) == ""


@pytest.mark.parametrize("one", OWN, ids=idents(OWN))
def test_a_method_states_a_bound_or_is_a_reference_or_says_how_it_fails(one: Method) -> None:
    assert one.bounds or one.reference or one.fails


@pytest.mark.parametrize("one", OWN, ids=idents(OWN))
def test_what_fails_has_a_survivor_or_says_that_none_is_known(one: Method) -> None:
    if one.valid and not one.survivor:
        assert one.fails, "it has a range, but does not say what happens beyond it"
    if one.survivor:
        assert one.fails, "it has a survivor, but does not say of what"
        survivor = find(one.task, one.survivor)
        assert survivor is not one
        assert not survivor.reference, "its survivor is never chosen"


@pytest.mark.parametrize("one", OWN, ids=idents(OWN))
def test_survivors_lead_to_an_end_or_to_each_other_by_name(one: Method) -> None:
    """Two methods may survive each other's failures; a longer way round would lead nowhere."""
    way = [one.name]
    while (survivor := find(one.task, way[-1]).survivor) and survivor not in way:
        way.append(survivor)
    if survivor:
        assert way.index(survivor) >= len(way) - 2, f"{' -> '.join([*way, survivor])} leads nowhere"


@pytest.mark.parametrize(
    ("evidence", "words"),
    [
        ("somebody said so", "names no file"),
        ("tests/no_such_file.py", "there is none"),
        ("palp study run no-such-study", "there is none"),
        ("palp study run contact-stability; tests/methods/test_evidence.py", ""),
    ],
)
def test_evidence_that_is_none_is_found(evidence: str, words: str) -> None:
    told = unfounded(Method("t", "m", str, 1.0, (), evidence, {}, "", ""))
    assert words in told
    assert bool(words) == bool(told)
