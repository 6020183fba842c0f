"""The register: what is declared, how it is found, and that the choice is the cheapest that will do."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palp_core.errors import MethodError
from palp_core.methods import (
    QUANTITIES,
    Bound,
    choose,
    declare_quantity,
    declare_task,
    find,
    method,
    methods,
    outside,
    register,
    weigh,
)
from palp_core.palpation.mechanics.scene.scene import Scene, Tolerance
from palp_core.palpation.session.method_choices import session_quantities

TASK = "sharpen"
declare_quantity("steel", "1", "how hard a blade is")


@pytest.fixture
def empty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let declarations of a test be forgotten after it."""
    monkeypatch.setattr(register, "_REGISTER", dict(register._REGISTER))
    monkeypatch.setattr(register, "_TASKS", dict(register._TASKS))
    monkeypatch.setattr(register, "_BROKEN", dict(register._BROKEN))


def declared(
    name: str,
    cost_s: float,
    *bounds: Bound,
    task: str = TASK,
    fails: str = "",
    survivor: str = "",
    reference: str = "",
) -> None:
    def way() -> None: ...

    way.__qualname__ = name
    method(
        task=task,
        name=name,
        cost_s=cost_s,
        bounds=bounds,
        evidence="here",
        fails=fails,
        survivor=survivor,
        reference=reference,
    )(way)


@pytest.mark.usefixtures("empty")
def test_the_cheapest_that_is_right_enough_is_chosen_and_gives_the_states_of_cheaper_ones() -> None:
    declared("blunt", 1.0, Bound("edge", 0.5), survivor="fine")
    declared("fine", 2.0, Bound("edge", 0.01, within={"steel": (0.0, 1.0)}))
    declared("finest", 3.0, Bound("edge", 0.001))
    chosen = choose(TASK, "edge", 0.05, {"steel": 0.5})
    assert (chosen.name, chosen.bound) == ("fine", 0.01)
    assert "cheaper: blunt (not accurate enough: within 50.0% only)" in chosen.reason
    assert [c.mark for c in chosen.candidates] == ["not accurate enough", "chosen", ""]
    assert choose(TASK, "edge", 0.05, {"steel": (0.5, 1.5)}).name == "finest"
    with pytest.raises(MethodError, match=r"no sharpen method gives 'edge' within 0\.01% at steel = 0\.5"):
        choose(TASK, "edge", 1e-4, {"steel": 0.5})


@pytest.mark.usefixtures("empty")
def test_one_asked_for_by_name_is_taken_with_its_stated_error() -> None:
    declared("blunt", 1.0, Bound("edge", 0.5), fails="on hard wood")
    declared("fine", 2.0, Bound("edge", 0.01))
    chosen = choose(TASK, "edge", 0.05, {}, asked="blunt")
    assert (chosen.name, chosen.bound, chosen.asked) == ("blunt", 0.5, True)
    assert [c.mark for c in chosen.candidates] == ["chosen", ""]
    silent = choose(TASK, "weight", 0.05, {}, asked="blunt")
    assert silent.bound is None
    assert "it fails at: on hard wood; finer: none" in silent.reason


@pytest.mark.usefixtures("empty")
def test_a_reference_is_never_chosen_though_it_be_the_best() -> None:
    declared("perfect", 1e-9, Bound("edge", 0.0), reference="it is a drawing")
    declared("fine", 2.0, Bound("edge", 0.01))
    assert choose(TASK, "edge", 0.05, {}).name == "fine"
    assert weigh(TASK, "edge", 0.05, {})[0].mark == "not available here"
    assert choose(TASK, "edge", 0.05, {}, asked="perfect").name == "perfect"


@pytest.mark.usefixtures("empty")
def test_a_budget_is_held_against_all_uses() -> None:
    declared("fine", 2.0, Bound("edge", 0.01))
    assert choose(TASK, "edge", 0.05, {}, uses=2, budget_s=4.0).name == "fine"
    with pytest.raises(MethodError, match=r"about 6 s .* for which no method is accurate enough"):
        choose(TASK, "edge", 0.05, {}, uses=3, budget_s=4.0)


@pytest.mark.usefixtures("empty")
def test_a_method_that_states_no_error_of_what_is_asked_says_what_it_states() -> None:
    declared("dull", 1.0)
    declared("fine", 2.0, Bound("grip", 0.1), Bound("weight", 0.1))
    dull, fine = weigh(TASK, "edge", 0.1, {})
    assert dull.state == "not accurate enough: no error bound for 'edge': it states no error"
    assert fine.why == "no error bound for 'edge': it states errors of grip, weight only"


@pytest.mark.parametrize(
    ("claim", "words"),
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
        ({"valid": {"speed": (0.0, 1.0)}}, "did you mean speed_m_s"),
    ],
)
def test_a_declaration_by_which_nothing_could_be_chosen_is_refused(claim: dict[str, Any], words: str) -> None:
    sound: dict[str, Any] = {"task": TASK, "name": "fine", "cost_s": 1.0, "evidence": "here"}
    method(**sound)
    with pytest.raises(MethodError, match=words):
        method(**{**sound, **claim})


@pytest.mark.parametrize(
    ("error", "within", "words"),
    [
        *((error, (0.0, 1.0), r"a bound on 'edge' of .* is none") for error in (-0.1, math.nan, math.inf)),
        *((0.1, within, r"steel in .*, which is nowhere") for within in ((1.0, 0.0), (math.nan, 1.0))),
    ],
)
def test_a_bound_that_bounds_nothing_is_refused(
    error: float, within: tuple[float, float], words: str
) -> None:
    """NaN is larger than no tolerance: such a method would be chosen everywhere."""
    with pytest.raises(MethodError, match=words):
        Bound("edge", error, within={"steel": within})


@pytest.mark.usefixtures("empty")
def test_a_range_in_a_quantity_that_nobody_declared_is_refused_with_those_that_are_near() -> None:
    """It would be checked in no scene, and so hold in all of them."""
    words = r"'fine' of task 'sharpen': 'dpeth_m' is no quantity of scenes; did you mean depth_m"
    with pytest.raises(MethodError, match=words):
        declared("fine", 1.0, Bound("edge", 0.1), Bound("edge", 0.01, within={"dpeth_m": (0.0, 0.004)}))
    with pytest.raises(MethodError, match=r"a scene for task 'sharpen': 'dpeth_m' is no quantity"):
        choose(TASK, "edge", 0.05, {"dpeth_m": 0.5})
    with pytest.raises(MethodError, match=r"'steel' is declared already: how hard a blade is \(1\)"):
        declare_quantity("steel", "kg", "how heavy a blade is")


def test_every_quantity_that_a_session_tells_is_declared_and_every_one_has_unit_and_meaning() -> None:
    told = {*session_quantities(Scene()), *Scene(tolerance=Tolerance(output="separation")).quantities()}
    assert told <= QUANTITIES.keys()
    assert all(unit and meaning for unit, meaning in QUANTITIES.values())


@pytest.mark.usefixtures("empty")
def test_a_name_is_taken_once_and_a_task_is_one_thing() -> None:
    declared("fine", 2.0)
    with pytest.raises(MethodError, match="'fine' of task 'sharpen' is declared twice, first in tests"):
        method(task=TASK, name="fine", cost_s=1.0, evidence="here")(str)
    with pytest.raises(MethodError, match=r"task 'sharpen' has methods \(fine\), but no declaration"):
        register.task(TASK)
    declare_task(TASK, "How?", per="a knife", output="edge", tolerance=0.1)
    declare_task(TASK, "How?", per="a knife", output="edge", tolerance=0.1)
    with pytest.raises(MethodError, match="task 'sharpen' is declared twice"):
        declare_task(TASK, "Why?", per="a knife", output="edge", tolerance=0.1)


def test_what_is_not_declared_is_said_with_what_is() -> None:
    with pytest.raises(MethodError, match="no method 'l9' for task 'contact'; declared: l0, l2, "):
        find("contact", "l9")
    with pytest.raises(MethodError, match="no_such_lab cannot be imported"):
        find("contact", "no_such_lab:felt")
    with pytest.raises(MethodError, match="no task 'nothing'; there are "):
        register.task("nothing")


def test_a_range_that_a_scene_leaves_is_named_with_its_value() -> None:
    assert outside("contact", "l2", {"poisson": 0.49}) == ""
    assert outside("contact", "l2", {"poisson": (0.4, 0.49)}) == (
        "l2 is outside its valid range: poisson = 0.4 and 0.49 is not in [0.45, 0.5]; l4 survives there"
    )


@pytest.fixture(scope="module")
def many() -> Iterator[None]:
    """Methods of one task at every cost and error of a grid."""
    before = dict(register._REGISTER)
    for i in range(6):
        for j in range(6):
            declared(
                f"m{i}{j}",
                1.0 + i,
                Bound("edge", 10.0 ** (-j), within={"steel": (0.0, 1.0 + j)}),
                task="grind",
            )
    yield
    register._REGISTER.clear()
    register._REGISTER.update(before)


@pytest.mark.usefixtures("many")
@given(tolerance=st.floats(1e-7, 2.0), steel=st.floats(0.0, 7.0))
def test_nothing_cheaper_than_the_chosen_one_would_have_done(tolerance: float, steel: float) -> None:
    good = [
        m for m in methods("grind") if (b := m.bound("edge", {"steel": steel})) is not None and b <= tolerance
    ]
    offers = weigh("grind", "edge", tolerance, {"steel": steel})
    chosen = [o for o in offers if o.mark == "chosen"]
    assert len(chosen) == bool(good)
    assert all(o.name == good[0].name for o in chosen)
    assert {o.name for o in offers if o.mark in ("chosen", "")} == {m.name for m in good}
