"""The one choice: the cheapest method that is accurate enough, or the one asked for."""

from dataclasses import dataclass

from palp_core.errors import MethodError
from palp_core.methods.register import (
    Method,
    Quantities,
    find,
    left_out,
    methods,
    quantity_text,
    register,
)

CHOSEN = "chosen"
DEFAULT = "default (published)"
INACCURATE = "not accurate enough"
UNAVAILABLE = "not available here"
"""The states of a method; one that is accurate enough but more expensive than the chosen one has none."""


@dataclass(frozen=True)
class Candidate:
    """A method's stated error and cost in a scene, and whether it can be used there, with the reason."""

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
    """The method for a task in a scene, and why; ``candidates`` are all of the task, cheapest first."""

    method: Method
    bound: float | None
    reason: str
    output: str
    tolerance: float
    candidates: tuple[Candidate, ...]
    asked: bool = False

    @property
    def name(self) -> str:
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
            asked for, or the scene has a quantity that no table lists; the message has each one's state.
    """
    chosen = find(task, asked) if asked else None
    candidates = weigh(task, output, tolerance, scene, asked=asked, uses=uses)
    if chosen is not None:
        bound = chosen.bound(output, scene)
        stated = f"no bound on '{output}'" if bound is None else f"'{output}' within {amount(bound, output)}"
        why = f"{chosen.name}: asked for by name; {stated} here, evidence {chosen.evidence}"
        if bound is None and chosen.fails:
            why += f"; it fails at: {chosen.fails}; finer: {chosen.survivor or 'none'}"
        return MethodChoice(chosen, bound, why, output, tolerance, candidates, asked=True)
    wanted = f"'{output}' within {amount(tolerance, output)}"
    found = next((c for c in candidates if c.mark == CHOSEN), None)
    if found is None:
        states = [*(f"{c.name} ({c.state})" for c in candidates), *left_out()]
        raise MethodError(
            f"no {task} method gives {wanted} at {_where(task, output, scene) or 'this'}: "
            f"{'; '.join(states) or 'there is none'}; relax the tolerance or add a finer method"
        )
    if budget_s is not None and found.cost_s > budget_s:
        affordable = [(c.bound, c.name) for c in candidates if c.bound is not None and c.cost_s <= budget_s]
        best = min(affordable, default=None)
        offer = f"{best[1]} gives {amount(best[0], output)}" if best else "no method is accurate enough"
        raise MethodError(
            f"{wanted} takes {found.name}, about {found.cost_s:g} s with nothing cached; budget_s is "
            f"{budget_s:g}, for which {offer}; raise budget_s or relax the tolerance"
        )
    chosen = find(task, found.name)
    why = f"{found.name}: '{output}' within {amount(found.bound or 0.0, output)} "
    why += f"(asked: {amount(tolerance, output)}), evidence {chosen.evidence}"
    if cheaper := [f"{c.name} ({c.state})" for c in candidates[: candidates.index(found)]]:
        why += f"; cheaper: {'; '.join(cheaper)}"
    why += "".join(f"; left out: {why_not}" for why_not in left_out())
    return MethodChoice(chosen, found.bound, why, output, tolerance, candidates)


def weigh(
    task: str, output: str, tolerance: float, scene: Quantities, *, asked: str = "", uses: int = 1
) -> tuple[Candidate, ...]:
    """Return what every method of a task offers a scene, cheapest first; arguments as for :func:`choose`.

    Chosen is the one asked for, or the cheapest that is accurate enough, if any is.
    """
    register().require_quantities(scene, f"a scene for task '{task}'")
    name = asked.rpartition(":")[2]
    found: list[Candidate] = []
    chosen = False
    for method in methods(task):
        mark, why = _state(method, output, tolerance, scene)
        if name:
            mark = CHOSEN if method.name == name else mark
        elif not mark and not chosen:
            mark, why, chosen = CHOSEN, f"the cheapest within {amount(tolerance, output)}", True
        found.append(Candidate(method.name, method.bound(output, scene), method.cost_s * uses, mark, why))
    return tuple(found)


def _state(method: Method, output: str, tolerance: float, scene: Quantities) -> tuple[str, str]:
    """Return a method's state in a scene and why; no state where it is accurate enough."""
    bound = method.bound(output, scene)
    if method.reference:
        return UNAVAILABLE, f"a reference: {method.reference}"
    if bound is not None:
        if bound > tolerance:
            return INACCURATE, f"within {amount(bound, output)} only"
        return "", "accurate enough, but more expensive"
    finer = f"; {method.survivor} is the next finer one" if method.survivor else ""
    if missed := method.missed(output, scene):
        return UNAVAILABLE, f"no error bound for '{output}': {missed}{finer}"
    others = ", ".join(dict.fromkeys(bound.output for bound in method.bounds))
    stated = f"it states errors of {others} only" if others else "it states no error"
    return INACCURATE, f"no error bound for '{output}': {stated}{finer}"


def _where(task: str, output: str, scene: Quantities) -> str:
    """Return the quantities of a scene by which a task's methods differ, as text."""
    named = set[str]()
    for method in methods(task):
        named.update(method.valid, *(bound.within for bound in method.bounds if bound.output == output))
    return ", ".join(f"{name} = {quantity_text(scene[name])}" for name in sorted(named & scene.keys()))


def amount(error: float, output: str) -> str:
    """Return an error of an output as text: a time if the output is one (``age_s``), else in per cent."""
    if output.endswith("_s"):
        return f"{error:.3g} s"
    return f"{error:.1%}" if error >= 1e-3 else f"{100.0 * error:.2g}%"


def seconds(time_s: float) -> str:
    """Return a time with the unit that suits it.

    >>> seconds(0.00325), seconds(2.5e-6)
    ('3.25 ms', '2.5 us')
    """
    for factor, unit in ((1.0, "s"), (1e3, "ms")):
        if time_s * factor >= 1.0:
            return f"{time_s * factor:.3g} {unit}"
    return f"{time_s * 1e6:.3g} us"
