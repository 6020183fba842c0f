"""The one choice: the cheapest method that is accurate enough, or the one asked for."""

from collections.abc import Sequence
from dataclasses import dataclass

from palp_core.errors import MethodError
from palp_core.methods.quantities import require_declared
from palp_core.methods.register import Method, Quantities, find, left_out, methods, values_of

CHOSEN = "chosen"
DEFAULT = "default (published)"
INACCURATE = "not accurate enough"
UNAVAILABLE = "not available here"
"""The states of a method; one that is accurate enough but more expensive than the chosen one has none."""


@dataclass(frozen=True)
class Candidate:
    """What one method offers a scene.

    Attributes:
        name: Its name.
        bound: Stated error of what is asked for there; None where it states none.
        cost_s: Seconds of one core for as many uses as the scene takes.
        mark: Its state: :data:`CHOSEN`, :data:`DEFAULT`, :data:`INACCURATE`, :data:`UNAVAILABLE`, or empty.
        why: Why it has this state.
    """

    name: str
    bound: float | None
    cost_s: float
    mark: str
    why: str

    @property
    def state(self) -> str:
        """State and reason, as in ``not accurate enough: within 22.0% only``."""
        return f"{self.mark}: {self.why}" if self.mark else self.why


@dataclass(frozen=True)
class MethodChoice:
    """A method for a task in a scene.

    Attributes:
        method: The method as declared.
        bound: Its stated error of ``output`` there; None where it states none.
        reason: Why it was chosen.
        output: What must be right.
        tolerance: How right.
        candidates: All methods of the task, cheapest first.
        asked: Whether it was asked for by name.
    """

    method: Method
    bound: float | None
    reason: str
    output: str
    tolerance: float
    candidates: tuple[Candidate, ...]
    asked: bool = False

    @property
    def name(self) -> str:
        """Name of the method."""
        return self.method.name


def choose(
    task: str,
    output: str,
    tolerance: float,
    scene: Quantities,
    *,
    asked: str = "",
    uses: int = 1,
    budget_s: float | None = None,
) -> MethodChoice:
    """Return the cheapest method whose stated error of ``output`` in ``scene`` is within ``tolerance``.

    Args:
        task: What is to be done.
        output: The quantity that must be right.
        tolerance: Largest acceptable error; relative, unless the task says otherwise.
        scene: Quantities of the scene by name, SI, as in ``{"depth_m": 0.008}``; a tuple where all its values
            occur, as in ``{"ring_m": (0.004, 0.016)}``.
        asked: Name of a method to take whatever its stated error is.
        uses: How often the method is used there.
        budget_s: Seconds of one core that all uses may take; None: as many as it takes.

    Raises:
        MethodError: None is accurate enough, the cheapest takes longer than the budget, none has the name
            asked for, or the scene tells a quantity that nobody declared; the message has each one's state.
    """
    wanted = find(task, asked) if asked else None
    candidates = weigh(task, output, tolerance, scene, asked=asked, uses=uses)
    if wanted is not None:
        bound = wanted.bound(output, scene)
        reason = _named(wanted, output, bound)
        return MethodChoice(wanted, bound, reason, output, tolerance, candidates, asked=True)
    found = next((c for c in candidates if c.mark == CHOSEN), None)
    if found is None:
        raise MethodError(_none(task, output, tolerance, scene, candidates))
    if budget_s is not None and found.cost_s > budget_s:
        raise MethodError(_too_dear(found, output, tolerance, candidates, budget_s))
    chosen = find(task, found.name)
    asked_for = amount(tolerance, output)
    why = f"{found.name}: '{output}' within {amount(found.bound or 0.0, output)} (asked: {asked_for})"
    why += f", evidence {chosen.evidence}"
    if cheaper := [f"{c.name} ({c.state})" for c in candidates[: candidates.index(found)]]:
        why += f"; cheaper: {'; '.join(cheaper)}"
    why += "".join(f"; left out: {words}" for words in left_out(task))
    return MethodChoice(chosen, found.bound, why, output, tolerance, candidates)


def weigh(
    task: str, output: str, tolerance: float, scene: Quantities, *, asked: str = "", uses: int = 1
) -> tuple[Candidate, ...]:
    """Return what every method of a task offers a scene, cheapest first; arguments as for :func:`choose`.

    One of them is marked as chosen: the one asked for, or the cheapest that is accurate enough, if any is.

    Raises:
        MethodError: The scene tells a quantity that nobody declared.
    """
    require_declared(scene, f"a scene for task '{task}'")
    name = asked.rpartition(":")[2]
    found: list[Candidate] = []
    chosen = False
    for one in methods(task):
        bound, cost_s = one.bound(output, scene), one.cost_s * uses
        mark, why = _state(one, output, tolerance, scene)
        if name:
            mark = CHOSEN if one.name == name else mark
        elif not mark and not chosen:
            mark, why, chosen = CHOSEN, f"the cheapest within {amount(tolerance, output)}", True
        found.append(Candidate(one.name, bound, cost_s, mark, why))
    return tuple(found)


def _state(one: Method, output: str, tolerance: float, scene: Quantities) -> tuple[str, str]:
    """Return a method's state in a scene and why; no state where it is accurate enough."""
    bound = one.bound(output, scene)
    if one.reference:
        return UNAVAILABLE, f"a reference: {one.reference}"
    if bound is not None:
        if bound > tolerance:
            return INACCURATE, f"within {amount(bound, output)} only"
        return "", "accurate enough, but more expensive"
    finer = f"; {one.survivor} is the next finer one" if one.survivor else ""
    if missed := one.missed(output, scene):
        return UNAVAILABLE, f"no error bound for '{output}': {missed}{finer}"
    others = ", ".join(dict.fromkeys(bound.output for bound in one.bounds))
    stated = f"it states errors of {others} only" if others else "it states no error"
    return INACCURATE, f"no error bound for '{output}': {stated}{finer}"


def _named(one: Method, output: str, bound: float | None) -> str:
    stated = (
        f"'{output}' within {amount(bound, output)}" if bound is not None else f"no bound on '{output}' here"
    )
    reason = f"{one.name}: asked for by name; {stated}, evidence {one.evidence}"
    if bound is None and one.fails:
        reason += f"; it fails at: {one.fails}; finer: {one.survivor or 'none'}"
    return reason


def _none(
    task: str, output: str, tolerance: float, scene: Quantities, candidates: Sequence[Candidate]
) -> str:
    told = _told_by(task, output)
    where = ", ".join(
        f"{name} = {' and '.join(f'{v:g}' for v in values_of(value))}"
        for name, value in sorted(scene.items())
        if name in told
    )
    states = (
        "; ".join([*(f"{c.name} ({c.state})" for c in candidates), *left_out(task)]) or "none is declared"
    )
    return (
        f"no {task} method gives '{output}' within {amount(tolerance, output)} at {where or 'this'}: "
        f"{states}; "
        "relax the tolerance or add a finer method"
    )


def _told_by(task: str, output: str) -> set[str]:
    """Return the quantities by which a task's methods are told apart."""
    ranges = [
        range_
        for one in methods(task)
        for range_ in (one.valid, *(bound.within for bound in one.bounds if bound.output == output))
    ]
    return {name for one in ranges for name in one}


def _too_dear(
    found: Candidate, output: str, tolerance: float, candidates: Sequence[Candidate], budget_s: float
) -> str:
    affordable = [c for c in candidates if c.bound is not None and c.cost_s <= budget_s]
    best = min(affordable, key=lambda c: c.bound or 0.0, default=None)
    offer = (
        f"{best.name} gives {amount(best.bound or 0.0, output)}" if best else "no method is accurate enough"
    )
    return (
        f"'{output}' within {amount(tolerance, output)} takes {found.name}, about {found.cost_s:g} s with "
        f"nothing cached; budget_s is {budget_s:g}, for which {offer}; raise budget_s or relax the tolerance"
    )


def amount(error: float, output: str) -> str:
    """Return an error of an output in words: a time if the output is one (``age_s``), else in per cent."""
    return f"{error:.3g} s" if output.endswith("_s") else percent(error)


def percent(share: float) -> str:
    """Return a share in per cent, small ones with two digits."""
    return f"{share:.1%}" if share >= 1e-3 else f"{100.0 * share:.2g}%"


def seconds(time_s: float) -> str:
    """Return a time with the unit that suits it.

    >>> seconds(0.00325), seconds(2.5e-6)
    ('3.25 ms', '2.5 us')
    """
    for factor, unit in ((1.0, "s"), (1e3, "ms")):
        if time_s * factor >= 1.0:
            return f"{time_s * factor:.3g} {unit}"
    return f"{time_s * 1e6:.3g} us"
