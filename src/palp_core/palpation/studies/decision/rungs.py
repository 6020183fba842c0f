"""End to end: do decisions agree with those of contact rung L4, and what does a trial cost in CPU?"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PalpError
from palp_core.methods import find, names
from palp_core.methods.measured import cpu_s
from palp_core.palpation.mechanics.scene.choice import choose_rung
from palp_core.palpation.perception.belief.stopping import PosteriorThreshold
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.policies import STIFF_M, begin_session, run_policy
from palp_core.palpation.studies.simulation.reading_table import Gel, scene_of, sweep_torque, tabulate
from palp_core.palpation.studies.toolkit.parallel import run_jobs, seeds

REFERENCE = "l4"
QUICK = ("l2", "l4")
FILTERS = ("naive", "latent")
FEATURES = ("peak", "contrast")
_LONG = "takes minutes, and was left out"


@dataclass(frozen=True)
class RungJob:
    """A contact rung to decide with.

    Attributes:
        rung: Its name.
        features: What is read off a sweep.
        filters: What is known to stay in a trial.
        sessions: How many.
        seed: Of the sessions.
    """

    rung: str
    features: tuple[str, ...]
    filters: tuple[str, ...]
    sessions: int
    seed: int


@dataclass(frozen=True, eq=False)
class RungWorld:
    """What a rung led to with one feature.

    Attributes:
        estimates: Classes decided for by filter, all sessions, shape (n,).
        probes: Mean probes a trial by filter.
        filter_s: CPU of a trial's filtering by filter.
        sweep_s: CPU of a sweep, its set-up not counted.
        words: Why there is nothing, or why it is not to be trusted here.
    """

    estimates: dict[str, NDArray[np.int64]]
    probes: dict[str, float]
    filter_s: dict[str, float]
    sweep_s: float
    words: str


def rung_rows(
    *, quick: bool = False, seed: int = 1, workers: int = 1, dask: str = ""
) -> list[dict[str, Any]]:
    """Return agreement and CPU of every contact rung, feature and filter; the arguments are a study's."""
    features = FEATURES[:1] if quick else FEATURES
    served = QUICK if quick else sorted(names("contact"))
    jobs = [RungJob(rung, features, FILTERS, 2 if quick else 6, seed) for rung in served]
    return rows_of(jobs, workers=workers, dask=dask)


def rows_of(jobs: Sequence[RungJob], *, workers: int = 1, dask: str = "") -> list[dict[str, Any]]:
    """Return agreement and CPU of contact rungs, by feature and filter.

    Training and trials are simulated with the rung, with the same luck as with the reference; decisions agree
    where both name the same depth. Cost is that of the sweeps a trial takes, plus its filter's, on one core.

    Args:
        jobs: The rungs that are served, the reference among them; others have a line that says why not.
        workers: Local processes.
        dask: Address of a Dask scheduler instead.
    """
    chosen = {feature: _chosen(Gel(feature=feature)) for feature in jobs[0].features}
    worlds = run_jobs(rung_world, jobs, label="rungs", workers=workers, dask=dask)
    found = {job.rung: world for job, world in zip(jobs, worlds, strict=True)}
    return [
        _row(rung, feature, filter_name, found, rung in chosen[feature])
        for rung in sorted(names("contact"))
        for feature in jobs[0].features
        for filter_name in jobs[0].filters
    ]


def _row(
    rung: str, feature: str, filter_name: str, found: Mapping[str, Mapping[str, RungWorld]], chosen: bool
) -> dict[str, Any]:
    world = found[rung][feature] if rung in found else None
    reference = found[REFERENCE][feature]
    agreement, cost, words = None, None, _LONG if world is None else world.words
    if world is not None and world.estimates:
        agreement = float(np.mean(world.estimates[filter_name] == reference.estimates[filter_name]))
        cost = world.probes[filter_name] * world.sweep_s + world.filter_s[filter_name]
    return {
        "rung": rung,
        "feature": feature,
        "filter": filter_name,
        "agreement": agreement,
        "cpu_s_per_trial": cost,
        "chosen": chosen,
        "unstable": bool(words),
        "words": words,
    }


def _chosen(gel: Gel) -> set[str]:
    return {choose_rung(scene_of(gel, depth_m)).rung for depth_m in gel.depths_m}


def rung_world(job: RungJob) -> dict[str, RungWorld]:
    """Return by feature what a rung leads to."""
    return {feature: _decide(job, feature) for feature in job.features}


def _decide(job: RungJob, feature: str) -> RungWorld:
    gel = Gel(rung=job.rung, rings_m=STIFF_M, feature=feature)
    conditions = Conditions(mounting="each_trial", trials=20)
    try:
        sweep_torque(gel, gel.depths_m[0], gel.rings_m[0])  # sets the rung up
        felt = tabulate(gel, noisy_sweeps=8)
        sweep_s = cpu_s(lambda: sweep_torque(gel, gel.depths_m[0], gel.rings_m[-1]))
    except PalpError as error:
        return RungWorld({}, {}, {}, float("nan"), str(error))
    estimates, probes, filter_s = {}, {}, {}
    for filter_name in job.filters:
        begun = time.thread_time_ns()
        ended = [
            run_policy(
                "uniform_stiff",
                begin_session(felt, conditions, one),
                PosteriorThreshold(),
                filter_name=filter_name,
            )
            for one in seeds(21, job.seed, job.sessions)
        ]
        count = sum(one.depth.size for one in ended)
        filter_s[filter_name] = 1e-9 * (time.thread_time_ns() - begun) / count
        estimates[filter_name] = np.concatenate([one.estimate for one in ended])
        probes[filter_name] = float(np.concatenate([one.probes for one in ended]).mean())
    return RungWorld(estimates, probes, filter_s, sweep_s, _doubt(job.rung, feature, gel))


def _doubt(rung: str, feature: str, gel: Gel) -> str:
    """Return why the register would not take the rung for this feature, or nothing."""
    bounds = [
        find("contact", rung).bound(feature, scene_of(gel, depth_m).quantities()) for depth_m in gel.depths_m
    ]
    return "" if all(bound is not None for bound in bounds) else f"no error bound for {feature} here"
