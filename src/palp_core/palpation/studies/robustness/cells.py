"""What the study ``robustness`` varies: one factor at a time around the paper's design."""

from dataclasses import dataclass, replace
from typing import Any

from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.policies import MarkovPolicy
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.gel import Gel
from palp_core.palpation.studies.simulation.session import WorldPlan


@dataclass(frozen=True)
class RobustnessCell:
    """A variation of the design.

    Attributes:
        factor: What is varied; empty for the centre.
        value: To what, as shown.
        plan: What is touched, the rig and the experiment.
        chain: How the human strategy is read: ``reconstruction, reading, mixture``.
    """

    factor: str
    value: str
    plan: WorldPlan
    chain: tuple[str, str, str] = ("ar1", "column", "average")

    @property
    def name(self) -> str:
        """Factor and value."""
        return f"{self.factor}: {self.value}" if self.factor else "centre"

    def markov(self) -> MarkovPolicy:
        """Return the human strategy as this cell reads it."""
        kind, reading, mixture = self.chain
        return MarkovPolicy(figure5.matrices(kind), reading=reading, mixture=mixture)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Factor:
    """One factor and its values.

    Attributes:
        name: As in tables.
        label: With its unit, for an axis.
        values: As shown, with what each sets, in order.
        centre: The value that the centre has.
        numeric: Whether values are numbers in order.
    """

    name: str
    label: str
    values: tuple[tuple[str, dict[str, Any]], ...]
    centre: str
    numeric: bool = True


def _numbers(field: str, unit: float, *values: float, **more: Any) -> tuple[tuple[str, dict[str, Any]], ...]:
    return tuple((f"{value:g}", {field: value * unit} | more.get(f"{value:g}", {})) for value in values)


# The contact models end at an indentation of one ball's radius (4.8 mm for l0): heights are tabulated to
# 0.5 mm there, five standard deviations, instead of 1.5 mm.
_NEAR = {"height_reach_m": 0.5e-3}

FACTORS = (
    Factor("modulus", "Young's modulus, kPa", _numbers("modulus_pa", 1e3, 5, 10, 15, 20, 25, 30), "20"),
    Factor("friction", "friction coefficient", _numbers("friction", 1.0, 0.15, 0.3, 0.45, 0.6, 0.8), "0.3"),
    Factor(
        "tip radius",
        "radius of the tip, mm",
        _numbers("tip_radius_m", 1e-3, 5, 6, 8, 10, **{"5": _NEAR}),
        "6",
    ),
    Factor(
        "indentation",
        "indentation, mm",
        _numbers("indentation_m", 1e-3, 2, 3, 4, 5, **{"5": _NEAR}),
        "4",
    ),
    Factor(
        "repeatability",
        "ring repeatability ±, mm",
        _numbers("repeatability_m", 1e-3, 0, 0.1, 0.2, 0.3, 0.45, 0.6),
        "0.3",
    ),
    Factor(
        "distribution",
        "law of the ring's landing",
        tuple(
            (n.replace("_", " "), {"distribution": n})
            for n in ("triangular", "normal", "uniform", "two_sided")
        ),
        "uniform",
        numeric=False,
    ),
    Factor(
        "height sd",
        "sd of the surface's height, mm",
        _numbers("height_sd_m", 1e-3, 0, 0.05, 0.1, 0.2, 0.3, 0.4),
        "0.1",
    ),
    Factor(
        "contact model",
        "contact model",
        (
            ("L0", {"rung": "l0"} | _NEAR),
            ("L2", {}),  # the one chosen for the default gel
            ("L4", {"rung": "l4"}),
        ),
        "L2",
        numeric=False,
    ),
    Factor("training", "training palpations a cell", _numbers("training", 1, 5, 10, 25, 50, 100), "25"),
    Factor(
        "training order",
        "order of training",
        (
            ("one mounting, re-homed", {}),
            ("re-mounted in blocks", {"mounting": "block_randomised"}),
            ("not re-homed", {"training_lands": "cell"}),
        ),
        "one mounting, re-homed",
        numeric=False,
    ),
    Factor(
        "human strategy",
        "reading of the human strategy",
        (
            ("AR(1)", {}),
            ("tridiagonal", {"chain": ("tridiagonal", "column", "average")}),
            ("gaussian reset", {"chain": ("ar1", "gaussian_reset", "average")}),
            ("mean", {"chain": ("ar1", "mean", "average")}),
            ("by belief", {"chain": ("ar1", "column", "posterior")}),
        ),
        "AR(1)",
        numeric=False,
    ),
)

CENTRE = RobustnessCell("", "", WorldPlan(gel=Gel()))
"""The paper's design."""


def cells(*, quick: bool = False, trials: int = 100) -> list[RobustnessCell]:
    """Return the centre and every cell that differs from it."""
    centre = replace(CENTRE, plan=replace(CENTRE.plan, conditions=Conditions(trials=trials)))
    found = [centre]
    for factor in FACTORS:
        varied = [_cell(centre, factor, value, sets) for value, sets in factor.values]
        if quick:
            varied = [varied[0], varied[-1]]
        found += [one for one in varied if one.value != factor.centre]
    return found


def _cell(centre: RobustnessCell, factor: Factor, value: str, sets: dict[str, Any]) -> RobustnessCell:
    gel = {k: v for k, v in sets.items() if k in Gel.__dataclass_fields__}
    conditions = {k: v for k, v in sets.items() if k in Conditions.__dataclass_fields__}
    plan = replace(
        centre.plan,
        gel=replace(centre.plan.gel, **gel),
        conditions=replace(centre.plan.conditions, **conditions),
    )
    return RobustnessCell(factor.name, value, plan, sets.get("chain", centre.chain))
