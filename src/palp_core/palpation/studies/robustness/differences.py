"""Trained in one world, judged in another: trials that differ from training in one thing.

A way that is still right is robust; one that is wrong and sure is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from palp_core.palpation.perception.strategy.figure5 import DEPTHS_M
from palp_core.palpation.studies.frontier.schemes import Scheme, SchemeRun, run_plan
from palp_core.palpation.studies.simulation.policy_summary import summarise
from palp_core.palpation.studies.simulation.session import Shift, WorldPlan, worlds
from palp_core.palpation.studies.toolkit.parallel import Runner

SCHEMES = (
    Scheme("peak", "fixed_best", "paper"),
    Scheme("peak", "information_gain", "paper"),
    Scheme("peak", "information_gain", "threshold"),
    Scheme("contrast", "fixed_best", "paper"),
    Scheme("contrast", "fixed_best", "threshold"),
    Scheme("contrast", "information_gain", "threshold"),
    Scheme("trace", "fixed_best", "threshold"),
    Scheme("trace", "fixed_best", "threshold", "swift"),
    Scheme("trace", "information_gain", "threshold", "swift"),
)
WORLDS = {"paper": worlds()["paper"], "lab": worlds("each_trial", "other")["lab"]}
"""The paper's own design; the lab's world with a mounting a trial, of phantoms that training had not."""


@dataclass(frozen=True)
class WorldDifference:
    """What the trials have that training had not.

    Attributes:
        name: In words.
        shift: Of the trials' sweeps, as of :class:`.WorldPlan`.
        rung: Contact model of the trials; empty: that of training.
        repeatability_m: The ring's in the trials; negative: that of training.
    """

    name: str
    shift: Shift = ()
    rung: str = ""
    repeatability_m: float = -1.0


DIFFERENCES = (
    WorldDifference("none"),
    *(WorldDifference(f"friction {x:+.0%}", (("friction", x),)) for x in (-0.2, -0.1, 0.1, 0.2)),
    *(
        WorldDifference(f"indentation {x:+g} mm", (("height_m", 1e-3 * x),))
        for x in (-0.3, -0.2, -0.1, 0.1, 0.2, 0.3)
    ),
    *(WorldDifference(f"modulus {x:+.0%}", (("modulus", x),)) for x in (-0.1, -0.05, 0.05, 0.1)),
    *(WorldDifference(f"tip radius {x:+g} mm", (("tip_radius_m", 1e-3 * x),)) for x in (-0.3, 0.3)),
    WorldDifference("ring +-0.6 mm", repeatability_m=0.6e-3),
    WorldDifference("contact by L2", rung="l2"),
    *(WorldDifference(f"bead {x:+g} mm along", (("along_m", 1e-3 * x),)) for x in (-2.0, 2.0)),
    WorldDifference("bead 3 mm off the path", (("beside_m", 3e-3),)),
)
QUICK = (DIFFERENCES[0], DIFFERENCES[4], DIFFERENCES[9])


def apply_difference(plan: WorldPlan, one: WorldDifference) -> WorldPlan:
    """Return a plan whose trials differ from its training."""
    return replace(plan, shift=one.shift, test_rung=one.rung, test_repeatability_m=one.repeatability_m)


def difference_rows(
    differences: Sequence[WorldDifference], count: int, *, trials: int, runner: Runner
) -> list[dict[str, Any]]:
    """Return a line per world, difference and scheme, over sessions that all differences share."""
    rows = []
    for world, usual in WORLDS.items():
        plan = replace(usual, conditions=replace(usual.conditions, trials=trials))
        plans, session = (
            [apply_difference(plan, one) for one in differences],
            partial(run_plan, schemes=SCHEMES),
        )
        found = runner.run(session, plans, count, stream=23, label=f"sessions, {world}")
        for one, sessions in zip(differences, found, strict=True):
            for scheme in sessions[0]:
                line = _line([own[scheme] for own in sessions])
                rows.append({"world": world, "difference": one.name, "scheme": scheme, **line})
    return rows


def _line(runs: Sequence[SchemeRun]) -> dict[str, Any]:
    line = summarise([one.ended for one in runs], DEPTHS_M)
    return {
        **{key: line[key] for key in ("accuracy", "ci", "ece", "ece_ci", "probes", "seconds", "undecided")},
    }
