"""The three scenes fixed in advance: is information gain with the latent filter better at equal seconds?"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap, share_interval, sign_flip
from palp_core.palpation.perception.strategy.policies_informed import Timing
from palp_core.palpation.studies.simulation.policy_summary import accuracies, summarise
from palp_core.palpation.studies.simulation.trials import Outcomes


def judge(sessions: Sequence[Mapping[str, Outcomes]], depths_m: Sequence[float]) -> dict[str, Any]:
    """Return a scene's lines and the paired comparison with the best fixed ring at equal seconds.

    A fixed ring stops after the first number of probes at which it has taken at least as long, on average, as
    information gain; ring and filter are the best in hindsight.

    Args:
        sessions: Outcomes by name, of :func:`.scene_session`, a session each.
        depths_m: Depth of each class.
    """
    gain = [one["information_gain_latent"] for one in sessions]
    budget_s = float(np.mean([one.seconds.mean() for one in gain]))
    fixed = {name: [one[name] for one in sessions] for name in sessions[0] if "/" in name}
    at_budget = {name: _right_at(found, budget_s) for name, found in fixed.items()}
    best = max(at_budget, key=lambda name: float(np.mean(at_budget[name][0])))
    right, seconds = at_budget[best]
    rng = np.random.default_rng(14)
    difference = accuracies(gain) - np.array([one.mean() for one in right])
    interval = cluster_bootstrap(difference, rng, within=(-1.0, 1.0))
    fixed_interval = share_interval(right, np.random.default_rng(15))
    lines = {
        name: summarise([one[name] for one in sessions], depths_m) for name in sessions[0] if "/" not in name
    }
    return lines | {
        "best_fixed": {
            "name": best,
            "accuracy": fixed_interval.value,
            "ci": [fixed_interval.low, fixed_interval.high],
            "seconds": seconds,
        },
        "difference": interval.value,
        "difference_ci": [interval.low, interval.high],
        "p": sign_flip(difference, rng),
        "better": interval.low > 0.0,
        "calibrated": lines["information_gain_latent"]["ece"] <= 0.03,
    }


def _right_at(sessions: Sequence[Outcomes], budget_s: float) -> tuple[list[NDArray[np.bool_]], float]:
    """Return which trials of each session are right after the probes that fill the budget, and their time."""
    probes = sessions[0].right.shape[1]
    whole_s = float(np.mean([one.seconds.mean() for one in sessions]))
    sweep_s = Timing().sweep_s
    first_s = whole_s - (probes - 1) * sweep_s  # a fixed ring moves once
    count = int(np.clip(np.ceil((budget_s - first_s) / sweep_s + 1.0 - 1e-9), 1, probes))
    return [one.right[:, count - 1] for one in sessions], first_s + (count - 1) * sweep_s
