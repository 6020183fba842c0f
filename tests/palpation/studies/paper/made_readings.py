"""Outcomes by reading that were made up, not run: for pages and tables."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from palp_core.palpation.studies.frontier.depth_error import DEPTH_SCHEMES, SWEEPS, DepthError
from palp_core.palpation.studies.frontier.schemes import SchemeRun
from palp_core.palpation.studies.frontier.tables import depth_rows
from palp_core.palpation.studies.paper.readings import SHOWN, gathered, side_by_side
from palp_core.palpation.studies.simulation.trials import Outcomes

RIGHT = {"peak": 0.8, "contrast": 1.0, "trace": 0.9}
LESS = {"fixed_best": 0.0, "uniform": 0.1, "markov": 0.2, "information_gain": 0.1}
"""What a policy is less right than the best fixed position, but by the contrast."""


def made_session(number: int, right: Mapping[str, float] = RIGHT) -> dict[str, SchemeRun]:
    """Return 60 trials of every scheme, of which so many are right."""
    depth = np.repeat(np.arange(3), 20)
    found = {}
    for scheme in SHOWN:
        share = right[scheme.reading] - (LESS[scheme.policy] if scheme.reading != "contrast" else 0.0)
        wrong = np.arange(60) >= round(60 * share) - number
        wrong &= share < 1.0
        flat = np.full(60, 0.9)
        ended = Outcomes(
            depth,
            (depth + wrong) % 3,
            flat,
            depth + 1,
            depth,
            10.0 * flat,
            flat > 0,
            flat[:, None],
            ~wrong[:, None],
        )
        found[scheme.name] = SchemeRun(ended, flat, 1e-4)
    return found


def made_readings() -> dict[str, Any]:
    """Return what :func:`.by_readings` returns, of two sessions of either world and one scene."""
    places = {
        name: side_by_side(name, [made_session(0), made_session(1)]) for name in ("paper", "lab", "easy")
    }
    off = [
        {
            (one.name, sweeps): DepthError(1e-6 / sweeps, 8.0 * sweeps)
            for one in DEPTH_SCHEMES
            for sweeps in SWEEPS
        }
    ] * 2
    return gathered(places, depth_rows("paper", off), sessions=2, depth_sessions=2)
