"""Declared costs are those that ``palp methods measure`` measures: CPU of one core, in the machine's unit."""

from __future__ import annotations

import sys

import pytest

from palp_core.methods import find
from palp_core.methods.measured import Measured, cpu_s, measured_tasks, measures_of, slowness
from palp_core.palpation.mechanics import Scene

FACTOR = 3.0
"""Off by more a cost is stale; off by less is another processor, faster with arrays than with words."""


def costs(task: str) -> dict[str, Measured]:
    """Return the point of each method as it is taken, in the scene, or where it is declared if not there."""
    found: dict[str, Measured] = {}
    for measure in measures_of(task)[0]:
        for one in measure(Scene()):
            if one.usual and not one.condition:
                found[one.method] = one
    return found


def off(task: str) -> dict[str, float]:
    """Return of each method by how much it costs more than is declared."""
    unit = slowness()
    return {name: one.cost_s / unit / find(task, name).cost_s for name, one in costs(task).items()}


def test_a_first_call_that_loads_modules_is_not_what_a_call_costs(monkeypatch: pytest.MonkeyPatch) -> None:
    now_ns = [0]

    def action() -> None:
        now_ns[0] += 1_000_000 if "of_a_test" in sys.modules else 1_000_000_000
        monkeypatch.setitem(sys.modules, "of_a_test", sys)

    assert cpu_s(action, clock=lambda: now_ns[0]) == 1e-3


@pytest.mark.nightly
@pytest.mark.parametrize("task", measured_tasks())
def test_declared_costs_are_measured_ones(task: str) -> None:
    ratios = off(task)
    stale = {name: round(ratio, 2) for name, ratio in ratios.items() if not 1 / FACTOR < ratio < FACTOR}
    assert ratios
    assert not stale, f"measured over declared: {stale}"
