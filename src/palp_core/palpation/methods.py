"""The register of exchangeable methods, and the one function that chooses among them.

A contact rung, a root finder, a feature, a likelihood, a stop rule or a policy is declared beside its code::

    @method(
        task="contact",
        name="l2",
        cost_s=0.05,
        bounds=[Bound("peak", 0.01), Bound("contrast", 0.10, within={"depth_m": (0.0, 0.004)})],
        evidence="tests/palpation/mechanics/contact/test_l2.py",
        fails="contrast over a deep bead",
        survivor="l4",
    )
    class LayeredHertz: ...

:func:`choose` then answers "what is the cheapest method that is good enough here?" and says why.
"""

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from palp_core.errors import MethodError

T = TypeVar("T")
Range = tuple[float, float]
Quantities = Mapping[str, float | tuple[float, ...]]
"""Quantities of a scene by name, SI; one value, or several that all occur."""


@dataclass(frozen=True)
class Bound:
    """A stated relative error of one output, and the scenes in which it holds.

    Attributes:
        output: What the bound is about, as in ``peak`` or ``contrast``.
        error: Largest relative error, dimensionless.
        within: Inclusive range per scene quantity; a quantity that the scene does not name is not checked.
    """

    output: str
    error: float
    within: Mapping[str, Range] = field(default_factory=dict)

    def holds(self, scene: Quantities) -> bool:
        """Tell whether every named quantity of the scene lies in its range, all its values if several."""
        return all(
            low <= value <= high
            for name, (low, high) in self.within.items()
            if name in scene
            for value in _values(scene[name])
        )


@dataclass(frozen=True)
class Method:
    """One declared method: what it does, what it costs, how wrong it is, and where it fails."""

    task: str
    name: str
    target: Any
    cost_s: float
    bounds: tuple[Bound, ...]
    evidence: str
    valid: Mapping[str, Range]
    fails: str
    survivor: str

    def bound(self, output: str, scene: Quantities) -> float | None:
        """Return the smallest stated error of ``output`` in ``scene``, or None where none is vouched for."""
        if not Bound(output, 0.0, self.valid).holds(scene):
            return None
        errors = [b.error for b in self.bounds if b.output == output and b.holds(scene)]
        return min(errors, default=None)


@dataclass(frozen=True)
class MethodChoice:
    """A chosen method with the bound that justified it and the reason in words."""

    method: Method
    bound: float
    reason: str


def _percent(share: float) -> str:
    return f"{share:.1%}" if share >= 1e-3 else f"{100.0 * share:.2g}%"


def _values(quantity: float | tuple[float, ...]) -> tuple[float, ...]:
    return quantity if isinstance(quantity, tuple) else (quantity,)


_REGISTER: dict[tuple[str, str], Method] = {}

_HOMES = {
    "burst": "palp_core.palpation.perception.emg.bursts",
    "contact": "palp_core.palpation.mechanics.contact",
    "denoise": "palp_core.palpation.perception.signal.wavelet",
    "equilibrium": "palp_core.palpation.mechanics.equilibrium.finders",
    "feature": "palp_core.palpation.perception.signal.features",
    "filter": "palp_core.palpation.perception.belief.latent",
    "friction": "palp_core.palpation.mechanics.equilibrium.friction",
    "likelihood": "palp_core.palpation.perception.belief.likelihoods",
    "motion": "palp_core.palpation.mechanics.equilibrium.dynamics",
    "policy": "palp_core.palpation.perception.strategy.policies_informed",
    "smoother": "palp_core.palpation.perception.signal.smoothers",
    "stop": "palp_core.palpation.perception.belief.stopping",
    "test": "palp_core.palpation.perception.statistics.mixed_logit",
}
"""Where the methods of a task are declared; imported when somebody asks for one."""


def method(
    *,
    task: str,
    name: str,
    cost_s: float,
    evidence: str,
    bounds: Sequence[Bound] = (),
    valid: Mapping[str, Range] | None = None,
    fails: str = "",
    survivor: str = "",
) -> Callable[[T], T]:
    """Declare the decorated function or class as a method of ``task``.

    Args:
        task: What it is exchangeable for, as in ``contact``, ``denoise``, ``stop``.
        name: Its name within the task.
        cost_s: Typical seconds of CPU for one use; orders the choice.
        evidence: Where the stated errors were established.
        bounds: Stated errors, each with the scenes in which it holds.
        valid: Range per scene quantity outside which the method must not be used at all.
        fails: What happens beyond that range.
        survivor: Name of the method of the same task to use there.

    Raises:
        MethodError: The name is already taken within the task.
    """

    def declare(target: T) -> T:
        if (task, name) in _REGISTER and _REGISTER[task, name].target is not target:
            raise MethodError(f"method '{name}' of task '{task}' is declared twice")
        _REGISTER[task, name] = Method(
            task, name, target, cost_s, tuple(bounds), evidence, dict(valid or {}), fails, survivor
        )
        return target

    return declare


def _load(task: str) -> None:
    home = _HOMES.get(task)
    if home is not None and home not in sys.modules:
        importlib.import_module(home)


def methods(task: str) -> list[Method]:
    """Return the methods of a task, cheapest first."""
    _load(task)
    return sorted((m for m in _REGISTER.values() if m.task == task), key=lambda m: (m.cost_s, m.name))


def names(task: str) -> list[str]:
    """Return the names of a task's methods, cheapest first."""
    return [one.name for one in methods(task)]


def find(task: str, name: str) -> Method:
    """Return one method by name.

    Raises:
        MethodError: There is none of that name; the message lists those there are.
    """
    _load(task)
    found = _REGISTER.get((task, name))
    if found is None:
        known = ", ".join(names(task)) or "none"
        raise MethodError(f"no method '{name}' for task '{task}'; declared: {known}")
    return found


def choose(task: str, output: str, tolerance: float, scene: Quantities) -> MethodChoice:
    """Return the cheapest method whose stated error of ``output`` in ``scene`` is within ``tolerance``.

    Args:
        task: What is to be done.
        output: The quantity that must be right.
        tolerance: Largest acceptable relative error, dimensionless.
        scene: Quantities of the scene by name, SI, as in ``{"depth_m": 0.008}``; a tuple where all its values
            occur, as in ``{"ring_m": (0.004, 0.016)}``.

    Raises:
        MethodError: None is good enough; the message says what each one vouches for.
    """
    refused: list[str] = []
    for candidate in methods(task):
        bound = candidate.bound(output, scene)
        if bound is None:
            hint = f"; {candidate.survivor} would be the next finer one" if candidate.survivor else ""
            refused.append(f"{candidate.name} vouches for no '{output}' here{hint}")
        elif bound > tolerance:
            refused.append(f"{candidate.name} is within {_percent(bound)} only")
        else:
            why = f"{candidate.name}: '{output}' within {_percent(bound)} (asked: {_percent(tolerance)})"
            why += f", evidence {candidate.evidence}"
            if refused:
                why += f"; cheaper but refused: {'; '.join(refused)}"
            return MethodChoice(candidate, bound, why)
    where = ", ".join(
        f"{name} = {' and '.join(f'{v:g}' for v in _values(value))}" for name, value in sorted(scene.items())
    )
    raise MethodError(
        f"no {task} method gives '{output}' within {_percent(tolerance)} at {where}: "
        + ("; ".join(refused) or "none is declared")
        + "; relax the tolerance or add a finer method"
    )
