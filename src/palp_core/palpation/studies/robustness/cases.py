"""What the study ``robustness`` varies: one factor of the paper's design, or the trials after training."""

from dataclasses import dataclass, replace
from typing import Any

from palp_core.palpation.perception.belief.stopping import PaperVerbatim, PosteriorThreshold, StopRule
from palp_core.palpation.studies.plan import Conditions, Gel
from palp_core.palpation.studies.schemes import FIXED, TRACE, Case, Scheme, lab_scheme
from palp_core.palpation.studies.session import WorldPlan, worlds

POLICIES = (
    *FIXED,
    "fixed_average",
    "fixed_best",
    "markov",
    "uniform",
    "uniform_stiff",
    "information_gain",
    "information_gain_latent",
    "reposition_best",
)
DESIGNS: dict[str, tuple[str, StopRule]] = {
    "paper": ("naive", PaperVerbatim()),
    "aware": ("latent", PosteriorThreshold()),
}
"""Filter and stop rule: the paper's; and the filter that knows what stays, with a threshold that can stop at
once."""


@dataclass(frozen=True)
class Factor:
    """One factor and its values."""

    name: str  # as in tables
    label: str  # with its unit, for an axis
    values: tuple[tuple[str, dict[str, Any]], ...]  # as shown, with what each sets, in order
    centre: str  # the value of the paper's design
    numeric: bool = True  # whether values are numbers in order


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
        "indentation", "indentation, mm", _numbers("indentation_m", 1e-3, 2, 3, 4, 5, **{"5": _NEAR}), "4"
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


def cells(*, quick: bool = False, trials: int = 100) -> list[Case]:
    """Return the centre and every cell that differs from it, as ``factor: value``."""
    found = [cell("centre", trials, {})]
    for factor in FACTORS:
        varied = [(value, sets) for value, sets in factor.values if value != factor.centre]
        if quick:
            ends = {factor.values[0][0], factor.values[-1][0]}
            varied = [(value, sets) for value, sets in varied if value in ends]
        found += [cell(f"{factor.name}: {value}", trials, sets) for value, sets in varied]
    return found


def cell(name: str, trials: int, sets: dict[str, Any]) -> Case:
    """Return every policy under both designs on a rig that differs from the paper's in some fields."""
    gel = Gel(**{k: v for k, v in sets.items() if k in Gel.__dataclass_fields__})
    conditions = {k: v for k, v in sets.items() if k in Conditions.__dataclass_fields__}
    plan = WorldPlan(gel=gel, conditions=Conditions(**({"trials": trials} | conditions)))
    chain = {"chain": sets["chain"]} if "chain" in sets else {}
    schemes = [
        Scheme(f"{design}/{policy}", policy, filter=known, stop=stop, **(chain if policy == "markov" else {}))
        for design, (known, stop) in DESIGNS.items()
        for policy in POLICIES
        if policy != "fixed_average"
    ]
    return Case(name, plan, tuple(schemes))


SCHEMES = tuple(
    lab_scheme(*words)
    for words in (
        ("peak", "fixed_best", "paper"),
        ("peak", "information_gain", "paper"),
        ("peak", "information_gain", "threshold"),
        ("contrast", "fixed_best", "paper"),
        ("contrast", "fixed_best", "threshold"),
        ("contrast", "information_gain", "threshold"),
        (TRACE, "fixed_best", "threshold"),
        (TRACE, "fixed_best", "threshold", "swift"),
        (TRACE, "information_gain", "threshold", "swift"),
    )
)
WORLDS = {"paper": worlds()["paper"], "lab": worlds("each_trial", "other")["lab"]}
"""The paper's own design; the lab's world with a mounting a trial, of phantoms that training had not."""

DIFFERENCES: dict[str, dict[str, Any]] = {
    "none": {},
    **{f"friction {x:+.0%}": {"shift": (("friction", x),)} for x in (-0.2, -0.1, 0.1, 0.2)},
    **{
        f"indentation {x:+g} mm": {"shift": (("height_m", 1e-3 * x),)}
        for x in (-0.3, -0.2, -0.1, 0.1, 0.2, 0.3)
    },
    **{f"modulus {x:+.0%}": {"shift": (("modulus", x),)} for x in (-0.1, -0.05, 0.05, 0.1)},
    **{f"tip radius {x:+g} mm": {"shift": (("tip_radius_m", 1e-3 * x),)} for x in (-0.3, 0.3)},
    "ring +-0.6 mm": {"test_repeatability_m": 0.6e-3},
    "contact by L2": {"test_rung": "l2"},
    **{f"bead {x:+g} mm along": {"shift": (("along_m", 1e-3 * x),)} for x in (-2.0, 2.0)},
    "bead 3 mm off the path": {"shift": (("beside_m", 3e-3),)},
}
"""What the trials' plan has that training's had not, by its name in words."""
QUICK_DIFFERENCES = [list(DIFFERENCES)[place] for place in (0, 4, 9)]


def difference_cases(world: str, names: list[str], trials: int) -> list[Case]:
    """Return the trials of a world that differ from its training in one thing."""
    usual = WORLDS[world]
    plan = replace(usual, conditions=replace(usual.conditions, trials=trials))
    return [Case(name, replace(plan, **DIFFERENCES[name]), SCHEMES) for name in names]
