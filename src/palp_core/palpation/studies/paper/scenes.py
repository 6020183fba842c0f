"""The three scenes fixed in advance: is information gain with the latent filter better at equal seconds?"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palp_core.palpation.perception.belief.stopping import FixedNumber, PosteriorThreshold
from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap, share_interval, sign_flip
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.policies_informed import Timing
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.gel import Gel
from palp_core.palpation.studies.simulation.policies import begin_trained, fixed_name, run_policy
from palp_core.palpation.studies.simulation.policy_summary import accuracies, summarise
from palp_core.palpation.studies.simulation.session import WorldPlan
from palp_core.palpation.studies.simulation.trials import Outcomes

SCENES: dict[str, WorldPlan] = {
    "easy": WorldPlan(gel=Gel(), conditions=Conditions(height_sd_m=0.0, mounting="each_trial")),
    "noisy": WorldPlan(
        gel=Gel(modulus_pa=30e3, noise_factor=5.0),
        conditions=Conditions(height_sd_m=0.1e-3, mounting="each_trial", training_lands="cell"),
    ),
    "unknown_height": WorldPlan(gel=Gel(), conditions=Conditions(height_sd_m=0.2e-3, mounting="each_trial")),
    "noisy_re_homed": WorldPlan(
        gel=Gel(modulus_pa=30e3, noise_factor=5.0),
        conditions=Conditions(height_sd_m=0.1e-3, mounting="each_trial"),
    ),
}
"""Fixed in advance: ring error only; noise, stiff gel and blocked training as well; height not known.

The last is a control, added afterwards: the noisy scene with a training that lands anew each time.
"""


def scene_session(plan: WorldPlan, seed: tuple[int, ...]) -> dict[str, Outcomes]:
    """Return the informed policies under the latent filter, and every fixed ring after 1, 2, ... probes."""
    trained, stop = begin_trained(plan, seed), PosteriorThreshold()

    def run(name: str, **how: Any) -> Outcomes:
        return run_policy(name, trained, stop, **({"filter_name": "latent"} | how))

    found = {
        "information_gain_latent": run("information_gain_latent"),
        "per_second": run("information_gain_latent", per_second=True),
        "naive": run("information_gain", filter_name="naive"),
        **{name: run(name) for name in ("uniform", "reposition_best", "fixed_best")},
    }
    last = FixedNumber(plan.conditions.max_probes)
    for ring_m in figure5.RINGS_M[1:]:
        name = fixed_name(ring_m)
        for filter_name in ("naive", "latent"):
            found[f"{name}/{filter_name}"] = run_policy(name, trained, last, filter_name=filter_name)
    return found


def judge(sessions: Sequence[Mapping[str, Outcomes]], depths_m: Sequence[float]) -> dict[str, Any]:
    """Return a scene's lines and the paired comparison with the best fixed ring at equal seconds.

    A fixed ring stops after the first number of probes at which it has taken at least as long, on average, as
    information gain; ring and filter are the best in hindsight.
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
