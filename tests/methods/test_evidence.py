"""Every claim of the register can be looked up: evidence that exists, failures with what survives them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from palp_core.methods import Bound, Method, find, left_out, methods, register, tasks
from palp_core.palpation.studies.catalogue import STUDIES

ROOT = Path(__file__).parents[2]

_FILE = re.compile(r"\b(?:tests|benchmarks)/[\w./-]+\.py")
_STUDY = re.compile(r"palp study run ([\w-]+)")


def faults(one: Method) -> Iterator[str]:
    """Yield what a method claims and does not hold."""
    files, studies = _FILE.findall(one.evidence), _STUDY.findall(one.evidence)
    if not files and not studies:
        yield f"'{one.evidence}' names no file of tests or benchmarks and no study"
    missing = [name for name in files if not (ROOT / name).is_file()]
    missing += [f"palp study run {name}" for name in studies if name not in STUDIES]
    if missing:
        yield f"{', '.join(missing)}: there is none"
    if not (one.bounds or one.reference or one.fails):
        yield "it has no bound, is no reference and does not say how it fails"
    if one.valid and not one.fails:
        yield "it has a range, but does not say what happens beyond it"
    if one.survivor and not one.fails:
        yield "it has a survivor, but does not say of what"
    if one.survivor and find(one.task, one.survivor).reference:
        yield f"its survivor {one.survivor} is a reference, which is never chosen"
    yield from wandering(one)


def wandering(one: Method) -> Iterator[str]:
    """Yield where a method's survivors come round; two may survive where the other fails."""
    way = [one.name]
    while survivor := find(one.task, way[-1]).survivor if len(way) > 1 else one.survivor:
        if survivor in way[:-2]:
            yield f"its survivors lead round: {' -> '.join([*way, survivor])}"
        if survivor in way:
            return
        way.append(survivor)


def test_the_register_holds_what_it_claims() -> None:
    own = [one for task in tasks() for one in methods(task.name) if one.module.startswith("palp_core.")]
    of = {one.task for one in own}
    assert {"contact", "motion", "feature", "filter", "stop", "policy"} <= of
    assert len(own) > 25
    assert [why for task in sorted(of) for why in left_out(task)] == []
    assert [f"{one.task} {one.name}: {fault}" for one in own for fault in faults(one)] == []


@pytest.mark.parametrize(
    ("claim", "words"),
    [
        ({}, ""),
        ({"evidence": "somebody said so"}, "names no file"),
        ({"evidence": "tests/no_such_file.py"}, "there is none"),
        ({"evidence": "palp study run no-such-study"}, "there is none"),
        ({"bounds": ()}, "does not say how it fails"),
        ({"valid": {"depth_m": (0.0, 1.0)}}, "what happens beyond it"),
        ({"survivor": "l4"}, "does not say of what"),
        ({"survivor": "m1", "fails": "often"}, "its survivors lead round: m -> m1 -> m2 -> m"),
    ],
)
def test_a_claim_that_does_not_hold_is_found(
    monkeypatch: pytest.MonkeyPatch, claim: dict[str, Any], words: str
) -> None:
    given: dict[str, Any] = {
        "bounds": (Bound("edge", 0.1),), "valid": {}, "fails": "", "survivor": "",
        "evidence": "palp study run stability; tests/methods/test_evidence.py", **claim,
    }  # fmt: skip
    for name, survivor in (("m1", "m2"), ("m2", "m")):
        monkeypatch.setitem(
            register._REGISTER,
            ("contact", name),
            Method(task="contact", name=name, target=str, cost_s=1.0, evidence="here", survivor=survivor),
        )
    found = list(faults(Method(task="contact", name="m", target=str, cost_s=1.0, **given)))
    assert len(found) == bool(words)
    assert words in "".join(found)
