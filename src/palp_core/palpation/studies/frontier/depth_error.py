"""How wrong a depth is that is told in millimetres: phantoms between the trained depths, by every scheme."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from palp_core.palpation.studies.frontier.protocols import PAPER_PROTOCOL, sessions_by_protocol
from palp_core.palpation.studies.frontier.schemes import SCHEMES, TRACE, DepthTask, Scheme, run_schemes
from palp_core.palpation.studies.simulation.session import WorldPlan

GRID_M = tuple(np.round(np.linspace(0.002, 0.008, 31), 9).tolist())
"""Depths to decide among."""
TRUE_M = GRID_M[::3]
"""Depths of the nodules: eleven, all along."""
SWEEPS = (1, 4)
"""How often each nodule is felt."""
_TRIALS = 12  # a depth
DEPTH_SCHEMES = tuple(
    one
    for one in SCHEMES
    if one.reading != TRACE or (one.rule == "threshold" and one.policy != "information_gain")
)
"""A trace has one filter; what a sweep would tell about 31 depths takes it a second, and is left out."""


@dataclass(frozen=True)
class DepthError:
    """What a scheme's mean depth was off by in a session.

    Attributes:
        squared_m2: Mean square over trials.
        seconds: Of the rig a trial.
    """

    squared_m2: float
    seconds: float


def depth_errors(
    plan: WorldPlan, seed: tuple[int, ...], *, schemes: tuple[Scheme, ...] = DEPTH_SCHEMES
) -> dict[tuple[str, int], DepthError]:
    """Return the error of the mean depth by scheme and number of sweeps."""
    conditions = replace(plan.conditions, trials=_TRIALS)
    swept = sessions_by_protocol(replace(plan, conditions=conditions, test_depths_m=TRUE_M), seed)
    true_m = np.asarray(TRUE_M)[swept(PAPER_PROTOCOL).depth]
    found = {}
    for sweeps in SWEEPS:
        for name, run in run_schemes(swept, schemes, DepthTask(GRID_M, sweeps)).items():
            off_m = run.ended.expected_m[:, -1] - true_m
            found[name, sweeps] = DepthError(float(np.mean(off_m**2)), float(run.ended.seconds.mean()))
    return found
