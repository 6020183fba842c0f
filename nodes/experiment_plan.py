"""Which plan the experiment follows, from its parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from palp_core.mechanics.phantom_file import load_phantoms
from palp_core.perception import plan
from palp_core.perception.figure5 import RINGS_M
from palp_core.perception.plan_repeatability import RepeatDesign, repeatability

if TYPE_CHECKING:
    from nodes.experiment import ExperimentParams

__all__ = ["classes_of", "design_of", "plan_of"]


def classes_of(params: ExperimentParams) -> dict[str, float]:
    """Return the depth of each phantom that has a bead, by code."""
    phantoms = load_phantoms(params.phantoms)
    return {code: p.bead.depth_m for code, p in phantoms.items() if p.bead is not None}


def design_of(params: ExperimentParams) -> plan.Design | RepeatDesign:
    """Return the numbers of the plan that the parameters name."""
    depths_m = classes_of(params)
    if params.plan == "repeatability":
        first = next(iter(depths_m), None) or next(iter(load_phantoms(params.phantoms)))  # bare gel will do
        return RepeatDesign(first, wait_s=params.wait_s)
    return plan.Design(
        phantoms=tuple(plan.Phantom(code, depth_m) for code, depth_m in depths_m.items()),
        rings_m=RINGS_M,
        repeats=params.training,
        trials_per_phantom=params.trials,
        order=params.training_order,
        rehome=params.rehome,
        training_mounts=params.training_mounts,
        estimation_mounts=params.estimation_mounts,
    )


def plan_of(design: plan.Design | RepeatDesign, seed: int) -> plan.Plan:
    """Return a fresh plan; the same seed gives the same one."""
    if isinstance(design, RepeatDesign):
        return repeatability(design)
    return plan.experiment(design, np.random.default_rng(seed))
