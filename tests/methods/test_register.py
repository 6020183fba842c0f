"""The register: what its tables hold, how it is found, and that the choice is the cheapest that will do."""

from __future__ import annotations

import inspect
import math
import pkgutil
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import FunctionType, SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palp_core.errors import MethodError
from palp_core.methods import (
    Bound,
    Method,
    Task,
    choose,
    find,
    left_out,
    methods,
    outside,
    quantities,
    register,
    tasks,
    weigh,
)
from palp_core.palpation.mechanics.contact.model import BesideBead, ContactModel
from palp_core.palpation.mechanics.scene.scene import Scene, Tolerance
from palp_core.palpation.perception.belief.stopping import StopRule
from palp_core.palpation.perception.strategy.policies import StiffnessPolicy
from palp_core.palpation.session.method_choices import session_quantities
from palp_core.palpation.studies.catalogue import STUDIES

ROOT = Path(__file__).parents[2]
SHARPEN = Task(name="sharpen", question="How?", per="a knife", output="edge", tolerance=0.1)
STEEL = {"steel": ("1", "how hard a blade is")}


def row(name: str, cost_s: float, *bounds: Bound, **more: Any) -> Method:
    return Method(
        **{"task": "sharpen", "place": "builtins:str", "evidence": "here", **more},
        name=name,
        cost_s=cost_s,
        bounds=bounds,
    )


def table(*rows: Method, **more: Any) -> SimpleNamespace:
    return SimpleNamespace(**{"TASKS": [SHARPEN], "QUANTITIES": STEEL, "METHODS": rows, **more})


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> register.Register:
    """A register of a test's own in the place of the process's."""
    made = register.Register()
    monkeypatch.setattr("palp_core.methods.choice.register", lambda: made)
    monkeypatch.setattr(register, "register", lambda: made)
    return made


def test_the_cheapest_that_is_right_enough_is_chosen_and_gives_the_states_of_cheaper_ones(
    fresh: register.Register,
) -> None:
    blunt = row("blunt", 1.0, Bound("edge", 0.5), survivor="fine")
    fine = row("fine", 2.0, Bound("edge", 0.01, within={"steel": (0.0, 1.0)}))
    fresh.add(table(blunt, fine, row("finest", 3.0, Bound("edge", 0.001))), "a lab")
    chosen = choose("sharpen", "edge", 0.05, {"steel": 0.5})
    assert (chosen.name, chosen.bound) == ("fine", 0.01)
    assert "cheaper: blunt (not accurate enough: within 50.0% only)" in chosen.reason
    assert [c.mark for c in chosen.candidates] == ["not accurate enough", "chosen", ""]
    assert choose("sharpen", "edge", 0.05, {"steel": (0.5, 1.5)}).name == "finest"
    with pytest.raises(MethodError, match=r"no sharpen method gives 'edge' within 0\.01% at steel = 0\.5"):
        choose("sharpen", "edge", 1e-4, {"steel": 0.5})
    with pytest.raises(MethodError, match=r"a scene for task 'sharpen': 'stele' is not a .* mean steel\?"):
        choose("sharpen", "edge", 0.05, {"stele": 0.5})


def test_one_asked_for_by_name_is_taken_with_its_stated_error_and_a_reference_only_then(
    fresh: register.Register,
) -> None:
    blunt = row("blunt", 1.0, Bound("edge", 0.5), fails="on hard wood")
    perfect = row("perfect", 1e-9, Bound("edge", 0.0), reference="it is a drawing")
    fresh.add(table(blunt, perfect, row("fine", 2.0, Bound("edge", 0.01))), "a lab")
    chosen = choose("sharpen", "edge", 0.05, {}, asked="blunt")
    assert (chosen.name, chosen.bound, chosen.asked) == ("blunt", 0.5, True)
    assert [c.mark for c in chosen.candidates] == ["not available here", "chosen", ""]
    silent = choose("sharpen", "weight", 0.05, {}, asked="blunt")
    assert silent.bound is None
    assert "it fails at: on hard wood; finer: none" in silent.reason
    assert choose("sharpen", "edge", 0.05, {}).name == "fine"
    assert choose("sharpen", "edge", 0.05, {}, asked="perfect").name == "perfect"


def test_a_budget_counts_all_uses_and_a_method_says_which_errors_it_states(fresh: register.Register) -> None:
    dull, fine = row("dull", 1.0), row("fine", 2.0, Bound("edge", 0.01), Bound("weight", 0.1))
    fresh.add(table(dull, fine), "a lab")
    assert choose("sharpen", "edge", 0.05, {}, uses=2, budget_s=4.0).name == "fine"
    with pytest.raises(MethodError, match=r"about 6 s .* for which no method is accurate enough"):
        choose("sharpen", "edge", 0.05, {}, uses=3, budget_s=4.0)
    first, second = weigh("sharpen", "grip", 0.1, {})
    assert first.state == "not accurate enough: no error bound for 'grip': it states no error"
    assert second.why == "no error bound for 'grip': it states errors of edge, weight only"


@pytest.mark.parametrize(
    ("claim", "problem"),
    [
        *(({"cost_s": cost_s}, "give the seconds of one use") for cost_s in (0.0, -1.0, math.nan, math.inf)),
        *(
            ({"name": name}, "a name is of letters")
            for name in ("", "auto", "my own", "lab:fine", "a\x1b[31m")
        ),
        ({"evidence": " "}, "'fine' of task 'sharpen' has no evidence"),
        ({"fails": "often", "survivor": "fine"}, "cannot survive where it fails itself"),
        ({"valid": {"steel": (1.0, 0.0)}}, r"steel in \[.*\], which is nowhere"),
        ({"valid": {"steel": (math.nan, 1.0)}}, r"steel in \[.*\], which is nowhere"),
    ],
)
def test_a_row_by_which_nothing_could_be_chosen_is_refused(claim: dict[str, Any], problem: str) -> None:
    with pytest.raises(MethodError, match=problem):
        row(**{"name": "fine", "cost_s": 1.0, **claim})


@pytest.mark.parametrize(
    ("error", "within", "problem"),
    [
        *((error, (0.0, 1.0), r"bound on 'edge': its error is") for error in (-0.1, math.nan, math.inf)),
        *((0.1, within, r"steel in .*, which is nowhere") for within in ((1.0, 0.0), (math.nan, 1.0))),
    ],
)
def test_a_bound_that_bounds_nothing_is_refused(
    error: float, within: tuple[float, float], problem: str
) -> None:
    """NaN is larger than no tolerance: such a method would be chosen everywhere."""
    with pytest.raises(MethodError, match=problem):
        Bound("edge", error, within={"steel": within})


@pytest.mark.parametrize(
    ("second", "problem"),
    [
        (table(row("fine", 9.0)), "'fine' of task 'sharpen' is listed twice, first at builtins:str"),
        (table(row("new", 1.0, task="grind")), "no task 'grind'; there are sharpen"),
        (
            table(TASKS=[Task(name="sharpen", question="Why?", per="", output="", tolerance=1.0)]),
            "'sharpen' is",
        ),
        (table(QUANTITIES={"steel": ("kg", "how heavy")}), r"'steel' is listed already: how hard a blade"),
        (
            table(row("new", 1.0, valid={"stele": (0.0, 1.0)})),
            "'stele' is not a quantity.*did you mean steel",
        ),
        (
            table(row("new", 1.0, Bound("edge", 0.1, {"stele": (0.0, 1.0)}))),
            "'stele' is not a quantity",
        ),
        (SimpleNamespace(), "it has no METHODS"),
    ],
)
def test_a_table_joins_as_a_whole_or_not_at_all(second: Any, problem: str) -> None:
    made = register.Register()
    made.add(table(row("fine", 2.0)), "a lab")
    made.add(table(row("fine", 2.0)), "a lab")  # read again it stays
    before = dict(made.methods), dict(made.tasks), dict(made.quantities)
    with pytest.raises(MethodError, match=f"another: .*{problem}"):
        made.add(second, "another")
    assert (made.methods, made.tasks, made.quantities) == before


def test_what_is_not_there_is_reported_with_what_is() -> None:
    with pytest.raises(MethodError, match="no method 'l9' for task 'contact'; there are l0, l2, "):
        find("contact", "l9")
    with pytest.raises(MethodError, match="no_such_lab cannot be imported"):
        find("contact", "no_such_lab:felt")
    with pytest.raises(MethodError, match="no task 'nothing'; there are "):
        register.task("nothing")
    assert outside("contact", "l2", {"poisson": 0.49}) == ""
    assert outside("contact", "l2", {"poisson": (0.4, 0.49)}) == (
        "l2 is outside its valid range: poisson = 0.4 and 0.49 is not in [0.45, 0.5]; l4 survives there"
    )


def test_every_quantity_that_a_session_has_is_listed_with_unit_and_meaning() -> None:
    known = {*session_quantities(Scene()), *Scene(tolerance=Tolerance(output="separation")).quantities()}
    assert known <= quantities().keys()
    assert all(unit and meaning for unit, meaning in quantities().values())


GRID = [
    row(f"m{i}{j}", 1.0 + i, Bound("edge", 10.0 ** (-j), within={"steel": (0.0, 1.0 + j)}))
    for i in range(6)
    for j in range(6)
]


@given(tolerance=st.floats(1e-7, 2.0), steel=st.floats(0.0, 7.0))
def test_nothing_cheaper_than_the_chosen_one_would_have_done(tolerance: float, steel: float) -> None:
    made = register.Register()
    made.add(table(*GRID), "a lab")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(register, "register", lambda: made)
        patch.setattr("palp_core.methods.choice.register", lambda: made)
        offers = weigh("sharpen", "edge", tolerance, {"steel": steel})
        known = methods("sharpen")
    good = [m for m in known if (b := m.bound("edge", {"steel": steel})) is not None and b <= tolerance]
    chosen = [o for o in offers if o.mark == "chosen"]
    assert len(chosen) == bool(good)
    assert all(o.name == good[0].name for o in chosen)
    assert {o.name for o in offers if o.mark in ("chosen", "")} == {m.name for m in good}


# what palp's own table says

OWN = [one for task in tasks() for one in methods(task.name) if one.module.startswith("palp_core.")]
_FILE = re.compile(r"\b(?:tests|benchmarks)/[\w./-]+\.py")
_STUDY = re.compile(r"palp study run ([\w-]+)")


def faults(one: Method) -> Iterator[str]:
    """Yield what a row claims and does not hold."""
    files, studies = _FILE.findall(one.evidence), _STUDY.findall(one.evidence)
    if not files and not studies:
        yield f"'{one.evidence}' names no file of tests or benchmarks and no study"
    missing = [name for name in files if not (ROOT / name).is_file()]
    missing += [f"palp study run {name}" for name in studies if name not in STUDIES]
    if missing:
        yield f"{', '.join(missing)}: there is none"
    if not (one.bounds or one.reference or one.fails):
        yield "it has no bound, is no reference and does not say how it fails"
    if (one.valid or one.survivor) and not one.fails:
        yield "it has a range or a survivor, but does not say what happens beyond"
    if one.survivor and find(one.task, one.survivor).reference:
        yield f"its survivor {one.survivor} is a reference, which is never chosen"
    if len(one.what) <= 10 or ":`" in one.what:
        yield f"'{one.what}' does not say what it is"
    way = [one.name]  # two may survive where the other fails
    while survivor := find(one.task, way[-1]).survivor:
        if survivor in way[:-2]:
            yield f"its survivors lead round: {' -> '.join([*way, survivor])}"
        if survivor in way:
            return
        way.append(survivor)


def test_palps_own_table_has_ten_tasks_and_holds_what_it_claims() -> None:
    ten = {
        "contact",
        "motion",
        "feature",
        "trace_filter",
        "filter",
        "likelihood",
        "stop",
        "policy",
        "burst",
        "denoise",
    }
    assert {one.task for one in OWN} == ten
    assert left_out() == []
    assert [f"{one}: {fault}" for one in OWN for fault in faults(one)] == []


NO_METHOD = {ContactModel, BesideBead, StopRule, StiffnessPolicy}
"""What looks like a method and is what methods have in common, or a model past a bead aside of the path."""


def public(kind: type) -> set[str]:
    return {name for name in dir(kind) if not name.startswith("_")}


def form(function: FunctionType) -> tuple[Any, ...]:
    """Return what a function takes and gives, names left out."""
    signature = inspect.signature(function)
    return (*(one.annotation for one in signature.parameters.values()), signature.return_annotation)


@pytest.mark.parametrize("task", sorted({one.task for one in OWN}))
def test_no_class_or_function_that_could_be_a_method_is_outside_the_table(task: str) -> None:
    targets = [one.target for one in OWN if one.task == task]
    classes = [one for one in targets if isinstance(one, type)]
    common = set.intersection(*map(public, classes)) if classes else set()
    forms = {form(one) for one in targets if isinstance(one, FunctionType)}
    outside_it = []
    for package in {target.__module__.rpartition(".")[0] for target in targets}:
        for info in pkgutil.iter_modules(import_module(package).__path__, f"{package}."):
            for name, one in () if info.ispkg else vars(import_module(info.name)).items():
                if getattr(one, "__module__", "") != info.name or one in targets or name.startswith("__"):
                    continue
                alike = isinstance(one, type) and common and common <= public(one)
                if (alike and one not in NO_METHOD) or (isinstance(one, FunctionType) and form(one) in forms):
                    outside_it.append(f"{info.name}:{name}")
    assert outside_it == []
