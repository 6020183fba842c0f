"""Every claim of the register can be looked up: evidence that exists, failures with what survives them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from palp_core.methods import Method, find, left_out, methods, tasks
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
