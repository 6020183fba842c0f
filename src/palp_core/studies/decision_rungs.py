"""End to end: do decisions agree with those of contact rung L4, and what does a trial cost in CPU?"""

from __future__ import annotations

from typing import Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.perception.stopping import PosteriorThreshold
from palp_core.runtime.clock import monotonic_ns
from palp_core.studies.batch_trials import Outcomes
from palp_core.studies.paper_jobs import seeds
from palp_core.studies.policy_table import begin, run
from palp_core.studies.touch import ERRORS_M, HEIGHTS_M, Gel, touch
from palp_core.studies.virtual_rig import Conditions

__all__ = ["REFERENCE", "rung_rows"]

REFERENCE = "l4"
_RUNGS = ("l0", "l1", "l2", "l4")


def rung_rows(*, quick: bool = False, seed: int = 1) -> list[dict[str, Any]]:
    """Return agreement and CPU of every contact rung, feature and filter.

    Training and trials are simulated with the rung, with the same luck as with the reference; decisions agree
    where both name the same depth. Cost is that of the sweeps a trial takes, plus its filter's, on one core.

    Args:
        quick: Few sessions, the peak only, and without the cheapest rungs.
        seed: Of the sessions; times are measured.
    """
    chosen = set(touch(Gel(), noisy_sweeps=2).rungs)
    rows: list[dict[str, Any]] = []
    for feature in ("peak",) if quick else ("peak", "contrast"):
        world = {}
        for rung in _RUNGS[2:] if quick else _RUNGS:
            world[rung] = _decide(rung, feature, 2 if quick else 6, seed)
        rows += [
            {
                "rung": rung,
                "feature": feature,
                "filter": filter_name,
                "agreement": _agreement(found, world[REFERENCE][0], filter_name),
                "cpu_s_per_trial": _cost(found, filter_name, sweep_s),
                "chosen": rung in chosen,
                "unstable": bool(words),
                "words": words,
            }
            for rung, (found, sweep_s, words) in world.items()
            for filter_name in ("naive", "latent")
        ]
    return rows


Found = dict[str, tuple[list[Outcomes], float]]


def _decide(rung: str, feature: str, sessions: int, seed: int) -> tuple[Found, float, str]:
    """Return outcomes and filter's seconds a trial by filter, seconds a sweep, and why it is unstable."""
    gel, conditions = Gel(rung=rung, feature=feature), Conditions(remount=True, trials=20)
    begun = monotonic_ns()
    try:
        felt = touch(gel, noisy_sweeps=8)
    except PalpError as error:
        return {}, float("nan"), str(error)
    cells = len(gel.depths_m) * len(gel.rings_m) * (len(ERRORS_M) * len(HEIGHTS_M) + 1)
    sweep_s = 1e-9 * (monotonic_ns() - begun) / cells
    found: Found = {}
    for filter_name in ("naive", "latent"):
        ended = []
        begun = monotonic_ns()
        for one in seeds(21, seed, sessions):
            session = begin(felt, conditions, one)
            ended.append(run("uniform_stiff", session, PosteriorThreshold(), filter_name=filter_name))
        count = sum(one.depth.size for one in ended)
        found[filter_name] = (ended, 1e-9 * (monotonic_ns() - begun) / count)
    return found, sweep_s, ""


def _agreement(found: Found, reference: Found, filter_name: str) -> float | None:
    if not found or not reference:
        return None
    pairs = zip(found[filter_name][0], reference[filter_name][0], strict=True)
    return float(np.mean(np.concatenate([a.estimate == b.estimate for a, b in pairs])))


def _cost(found: Found, filter_name: str, sweep_s: float) -> float | None:
    if not found:
        return None
    ended, filter_s = found[filter_name]
    return float(np.mean([one.probes.mean() for one in ended])) * sweep_s + filter_s
