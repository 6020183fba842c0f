"""Tasks ``likelihood``, ``burst``, ``test``: synthetic readings, people, sessions, whose truth is drawn."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np

from benchmarks.choice_bench.contest import Case, Reading, log_between, mean_reading
from palp_core.methods import weigh
from palp_core.palpation.perception.emg.bursts import BurstRule
from palp_core.palpation.perception.emg.peaks import EmgPeak, PeakFinder, distance_first
from palp_core.palpation.studies.perception.beliefs import overtrust
from palp_core.palpation.studies.perception.counts import LEVEL, Design, Recording, astray, p_value, recording

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


def burst(rng: np.random.Generator, _index: int) -> Case:
    """Draw a person, the RMS window, the distance of bursts, and whether they are counted as they come."""
    relax = float(rng.uniform(0.5, 1.0)) if rng.random() < 0.8 else float(rng.uniform(0.3, 0.5))
    window_s = float(rng.choice([0.15, 0.05, rng.uniform(0.03, 0.3)], p=[0.6, 0.2, 0.2]))
    distance_s = 0.4 if rng.random() < 0.8 else float(rng.uniform(0.2, 0.8))
    live = float(rng.random() < 0.5)
    seed = int(rng.integers(1 << 20))

    @cache
    def people(number: int) -> list[Recording]:
        return [recording(relax, window_s, seed + 64 * number + i) for i in range(_MINUTES * 2**number)]

    def measure(name: str, number: int) -> Reading:
        if name == "distance_first" and live:
            return Reading(np.inf)  # it wants the whole recording
        heard = people(number)
        finder = PeakFinder(heard[0].rate_hz, distance_s=distance_s)
        found = []
        peaks: Sequence[EmgPeak]
        for one in heard:
            if name == "two_thresholds":
                peaks = BurstRule(one.rate_hz, *one.rest).whole(one.value).peaks
            elif name == "distance_first":
                peaks = distance_first(finder, one.value)
            else:
                peaks = finder.whole(one.value)
            found.append(astray(peaks, one))
        return mean_reading(found)

    quantities = {
        "window_s": window_s, "relax_share": relax, "burst_distance_s": distance_s, "live": live,
    }  # fmt: skip
    words = (
        f"window {window_s:.3g} s, relaxed by {relax:.2g}, {distance_s:.2g} s apart{', live' * bool(live)}"
    )
    return Case("burst", "bursts", log_between(rng, 0.05, 0.8), quantities, measure, words)


def test(rng: np.random.Generator, _index: int) -> Case:
    """Draw sessions in which two conditions do not differ, and by how much alarms may be above 5 %."""
    design = Design(
        session_count=int(rng.integers(3, 31)),
        session_sd=0.0 if rng.random() < 0.3 else float(rng.uniform(0.0, 1.5)),
        paired_sd=0.0 if rng.random() < 0.5 else float(rng.uniform(0.0, 1.5)),
    )
    seed = int(rng.integers(1 << 31))
    tolerance = log_between(rng, 0.01, 0.1)
    quantities = {
        "session_count": float(design.session_count), "session_sd": design.session_sd,
        "paired_sd": design.paired_sd,
    }  # fmt: skip
    marks = {one.name: one.mark for one in weigh("test", "level", tolerance, quantities)}

    def measure(name: str, number: int) -> Reading:
        if name in _DEAR and marks[name] != "chosen":
            return Reading(np.inf)  # dearer than what is chosen
        chance, repeats = np.random.default_rng((seed, number)), _REPEATS * 2**number
        alarms = np.mean([p_value(name, design.draw(chance), chance) <= LEVEL for _ in range(repeats)])
        sd = math.sqrt(max(float(alarms), LEVEL) * (1.0 - float(alarms)) / repeats)
        return Reading(max(float(alarms) - LEVEL, 0.0), sd)

    words = f"{design.session_count} sessions, logit sd {design.session_sd:.2g}, {design.paired_sd:.2g}"
    return Case("test", "level", tolerance, quantities, measure, words)


CONTESTS: dict[str, Callable[[np.random.Generator, int], Case]] = {
    "likelihood": likelihood,
    "burst": burst,
    "test": test,
}
