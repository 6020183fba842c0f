"""What schemes did in sessions, as lines of a table: accuracy, seconds, depth in millimetres, differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap
from palp_core.palpation.perception.strategy.figure5 import DEPTHS_M
from palp_core.palpation.studies.frontier.depth_error import SWEEPS, DepthError
from palp_core.palpation.studies.frontier.schemes import SCHEMES, Scheme, SchemeRun
from palp_core.palpation.studies.simulation.policy_summary import paired, summarise
from palp_core.palpation.studies.toolkit.pareto import pareto_front

Runs = Sequence[Mapping[str, SchemeRun]]
"""What each scheme did, by name, a session each."""


def scheme_rows(world: str, sessions: Runs) -> list[dict[str, Any]]:
    """Return a line per scheme, with what is on the front of accuracy against seconds."""
    depths_m = DEPTHS_M
    rows = []
    for scheme in (one for one in SCHEMES if one.name in sessions[0]):
        runs = [one[scheme.name] for one in sessions]
        line = summarise([one.ended for one in runs], depths_m)
        kept = {
            key: line[key] for key in ("accuracy", "ci", "probes", "seconds", "ece", "ece_ci", "undecided")
        }
        rows.append(
            {
                "world": world,
                **_words(scheme),
                **kept,
                "cpu_ms": 1e3 * float(np.mean([one.cpu_s for one in runs])),
                "per_session": line["per_session"],
            }
        )
    front = pareto_front([row["seconds"] for row in rows], [-row["accuracy"] for row in rows])
    for number, row in enumerate(rows):
        row["front"] = number in front
    return rows


def compare_schemes(sessions: Runs, first: Scheme, second: Scheme) -> dict[str, Any]:
    """Return the paired difference of two schemes' accuracies and the ratio of their seconds."""
    pair = [[one[scheme.name].ended for one in sessions] for scheme in (first, second)]
    return {"first": first.name, "second": second.name, **paired(*pair)}


def depth_rows(world: str, sessions: Sequence[Mapping[tuple[str, int], DepthError]]) -> list[dict[str, Any]]:
    """Return a line per scheme and number of sweeps: the root mean squared error of the depth, m."""
    rows = []
    for scheme in (one for one in SCHEMES if (one.name, SWEEPS[0]) in sessions[0]):
        for sweeps in SWEEPS:
            ends = [one[scheme.name, sweeps] for one in sessions]
            squares = cluster_bootstrap(
                [one.squared_m2 for one in ends], np.random.default_rng(25), within=(0.0, np.inf)
            )
            rows.append(
                {
                    "world": world,
                    **_words(scheme),
                    "sweeps": sweeps,
                    "seconds": float(np.mean([one.seconds for one in ends])),
                    "rmse_m": float(np.sqrt(squares.value)),
                    "ci": [float(np.sqrt(max(squares.low, 0.0))), float(np.sqrt(squares.high))],
                }
            )
    return rows


def _words(scheme: Scheme) -> dict[str, str]:
    return {
        "reading": scheme.reading,
        "policy": scheme.policy,
        "rule": scheme.rule,
        "protocol": scheme.protocol,
        "scheme": scheme.name,
    }
