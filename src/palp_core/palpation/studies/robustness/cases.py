"""What the study ``robustness`` varies: one factor of the paper's design, or the trials after training."""

from dataclasses import dataclass, replace
from typing import Any

from palp_core.palpation.perception.belief.stopping import PaperVerbatim, PosteriorThreshold, StopRule
from palp_core.palpation.studies.plan import Conditions, Gel
from palp_core.palpation.studies.schemes import FIXED, TRACE, Case, Scheme, lab_scheme
from palp_core.palpation.studies.session import PLANS, WorldPlan

AVERAGE = "fixed_average"
POLICIES = (
    *FIXED,
    AVERAGE,
    "fixed_best",
    "markov",
    "uniform",
    "uniform_stiff",
    "information_gain",
    "information_gain_latent",
    "reposition_best",
)
DESIGNS: dict[str, tuple[str, str, StopRule]] = {
    "paper": ("the paper's filter and stop rule", "naive", PaperVerbatim()),
    "aware": (
        "filter that knows what stays, posterior threshold 0.95",
        "latent",
        PosteriorThreshold(),
    ),
}
"""What each is, its filter and its stop rule."""


@dataclass(frozen=True)
class Factor:
    """One factor and its values."""

    name: str  # as in tables
    values: tuple[tuple[str, dict[str, Any]], ...]  # as shown, with what each sets, in order
    centre: str  # the value of the paper's design


def _numbers(field: str, unit: float, *values: float, **more: Any) -> tuple[tuple[str, dict[str, Any]], ...]:
    return tuple((f"{value:g}", {field: value * unit} | more.get(f"{value:g}", {})) for value in values)


# The contact models end at an indentation of one ball's radius (4.8 mm for l0): heights are tabulated to
# 0.5 mm there, five standard deviations, instead of 1.5 mm.
_NEAR = {"height_reach_m": 0.5e-3}

FACTORS = (
    Factor("modulus", _numbers("modulus_pa", 1e3, 5, 10, 15, 20, 25, 30), "20"),
    Factor("friction", _numbers("friction", 1.0, 0.15, 0.3, 0.45, 0.6, 0.8), "0.3"),
    Factor("tip radius", _numbers("tip_radius_m", 1e-3, 5, 6, 8, 10, **{"5": _NEAR}), "6"),
    Factor("indentation", _numbers("indentation_m", 1e-3, 2, 3, 4, 5, **{"5": _NEAR}), "4"),
    Factor("repeatability", _numbers("repeatability_m", 1e-3, 0, 0.1, 0.2, 0.3, 0.45, 0.6), "0.3"),
    Factor(
        "distribution",
        tuple(
            (n.replace("_", " "), {"distribution": n})
            for n in ("triangular", "normal", "uniform", "two_sided")
        ),
        "uniform",
    ),
    Factor("height sd", _numbers("height_sd_m", 1e-3, 0, 0.05, 0.1, 0.2, 0.3, 0.4), "0.1"),
    Factor(
        "contact model",
        # L2 is the one chosen for the default gel
        (("L0", {"rung": "l0"} | _NEAR), ("L2", {}), ("L4", {"rung": "l4"})),
        "L2",
    ),
    Factor("training", _numbers("training", 1, 5, 10, 25, 50, 100), "25"),
    Factor(
        "training order",
        (
            ("one mounting, re-homed", {}),
            ("re-mounted in blocks", {"mounting": "block_randomised"}),
            ("not re-homed", {"training_lands": "cell"}),
        ),
        "one mounting, re-homed",
    ),
    Factor(
        "human strategy",
        (
            ("AR(1)", {}),
            ("tridiagonal", {"chain": ("tridiagonal", "column", "average")}),
            ("gaussian reset", {"chain": ("ar1", "gaussian_reset", "average")}),
            ("mean", {"chain": ("ar1", "mean", "average")}),
            ("by belief", {"chain": ("ar1", "column", "posterior")}),
        ),
        "AR(1)",
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
        for design, (_, known, stop) in DESIGNS.items()
        for policy in POLICIES
        if policy != AVERAGE
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


def difference_cases(*, quick: bool = False, trials: int = 100) -> dict[tuple[str, str], Case]:
    """Return the trials of each world that differ from its training in one thing, by world and difference."""
    asked = [*DIFFERENCES][:10:4] if quick else [*DIFFERENCES]
    found = {}
    for world, usual in PLANS.items():
        plan = replace(usual, conditions=replace(usual.conditions, trials=trials))
        for name in asked:
            found[world, name] = Case(name, replace(plan, **DIFFERENCES[name]), SCHEMES)
    return found
