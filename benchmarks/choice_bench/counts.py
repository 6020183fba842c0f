"""Task ``likelihood``: synthetic readings, whose truth is drawn."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.choice_bench.contest import Case, Reading, log_between, mean_reading
from palp_core.palpation.studies.perception.beliefs import overtrust

_TRIALS, _BATCHES, _REPEATS, _MINUTES = 2_500, 8, 500, 2
_DEAR = ("anova", "permutation", "mixed_logit")  # tests of which a thousand take half a minute


def likelihood(rng: np.random.Generator, _index: int) -> Case:
    """Draw training, gap of neighbouring classes, classes, probes and outliers."""
    beyond = bool(rng.random() < 0.2)
    count = int(rng.integers(2, 6)) if beyond else round(log_between(rng, 3, 120))
    gap_sd = float(rng.uniform(0.8, 2.0)) if beyond else log_between(rng, 2.0, 12.0)
    classes = int(rng.integers(2, 4)) if not beyond or rng.random() < 0.5 else 4
    probes = int(rng.integers(1, 16)) if rng.random() < 0.5 else 15
    share = 0.0 if rng.random() < 0.5 else float(rng.uniform(0.0, 0.03 if beyond else 0.01))
    seed = int(rng.integers(1 << 31))

    def measure(name: str, number: int) -> Reading:
        trials = _TRIALS * 4**number
        batches = [
            overtrust(
                name, count, gap_sd, share, trials, probes=probes, classes=classes, seed=(seed, number, i)
            )
            for i in range(_BATCHES)
        ]
        return mean_reading(batches)

    quantities = {
        "training_count": float(count), "class_gap_sd": gap_sd, "class_count": float(classes),
        "outlier_share": share, "probe_count": float(probes),
    }  # fmt: skip
    words = (
        f"{count} readings, {classes} classes {gap_sd:.3g} sd apart, {probes} probes, {share:.2%} outliers"
    )
    tolerance = log_between(rng, 0.006, 0.3)
    return Case("likelihood", "calibration", tolerance, quantities, measure, words)


CONTESTS: dict[str, Callable[[np.random.Generator, int], Case]] = {"likelihood": likelihood}
