"""The study ``power``: trials and sessions needed to see the paper's differences, and what its own show.

Trials of one session share training and mountings. How much that matters is measured on a pool of simulated
sessions; experiments are then drawn from the pool, tested over sessions, and counted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.studies.paper.numbers import HUMAN_OF, HUMAN_RIGHT, PUBLISHED
from palp_core.palpation.studies.power import model
from palp_core.palpation.studies.power.charts import curves_chart, effect_chart, paper_chart
from palp_core.palpation.studies.power.jobs import (
    COMPARISONS,
    POLICIES,
    CurveJob,
    curve_points,
    depth_power,
    false_alarms,
    pool_session,
    published_power,
)
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.policies import SessionJob
from palp_core.palpation.studies.simulation.reading_table import Gel, tabulate
from palp_core.palpation.studies.toolkit.parallel import run_jobs, seeds
from palp_core.units import Float64Array
from palp_core.whole_file import write_json

DEPTHS = len(Gel().depths_m)
SESSIONS = (2, 3, 4, 5, 6, 8, 10, 14, 20, 28, 40, 60, 80, 120)
TRIALS = (1, 2, 5, 10, 20, 50, 100)
PAPER_TRIALS = 100  # per depth, of each strategy
SUBJECTS, SUBJECT_TRIALS = 6, 5  # the paper's, per depth


@dataclass(frozen=True)
class PowerSize:
    """How much is run.

    Attributes:
        pool: Sessions of the pool.
        trials: Trials per depth of each of them, so that its own shares are known.
        repeats: Experiments per point.
    """

    pool: int = 200
    trials: int = 300
    repeats: int = 2000


FULL, QUICK = PowerSize(), PowerSize(pool=24, trials=60, repeats=200)


def run(out: Path, *, quick: bool = False, workers: int = 1, dask: str = "", seed: int = 1) -> Path:
    """Fill the pool, repeat experiments, write tables and charts, and return the page.

    Args:
        out: Folder for the files; made if missing.
        quick: A small pool, few repeats.
        workers: Local processes.
        dask: Address of a Dask scheduler instead.
        seed: Of everything; results do not depend on the workers.
    """
    size = QUICK if quick else FULL
    felt = tabulate(Gel())
    jobs = [SessionJob(felt, Conditions(trials=size.trials), one) for one in seeds(50, seed, size.pool)]
    found = run_jobs(pool_session, jobs, workers=workers, dask=dask, label="sessions")
    pool = {name: np.array([one[name] for one in found]) for name in POLICIES}
    laws = {
        name: model.intraclass(shares.mean(axis=1), size.trials * DEPTHS) for name, shares in pool.items()
    }
    curves = [CurveJob(pool, trials, SESSIONS, size.repeats, (51, seed, trials)) for trials in TRIALS]
    points = [
        {**row, "formula": _formula(pool, row)}
        for rows in run_jobs(curve_points, curves, workers=workers, dask=dask, label="curves")
        for row in rows
    ]
    rng = np.random.default_rng([52, seed])
    report: dict[str, Any] = {
        "quick": quick,
        "seed": seed,
        "pool": size.pool,
        "pool_trials": size.trials,
        "repeats": size.repeats,
        "policies": {name: _policy(shares, laws[name], size.repeats, rng) for name, shares in pool.items()},
        "differences": [_difference(pool, first, second) for first, second in COMPARISONS],
        "curves": points,
        "needed": _needed(points),
        "paper": _paper(laws, size.repeats, rng),
        "human": _human(size.repeats, rng),
    }
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "power.json", report)
    charts = [
        curves_chart(points, "sessions", (1, 5, 20, 100)),
        curves_chart(points, "trials", (4, 6, 10, 20, 60)),
        effect_chart(report["policies"]),
        paper_chart(report["paper"]),
    ]
    independent, one_session = list(report["paper"]["detectable"].values())[:2]
    return write_page(
        out / "index.html",
        "studies/power.html",
        report=report,
        pictures=[picture(chart, out) for chart in charts],
        independent=independent["80"],
        one_session=one_session["80"],
        differences={f"{one['first']} - {one['second']}": one for one in report["differences"]},
    )


def _formula(pool: Mapping[str, Float64Array], row: Mapping[str, Any]) -> float:
    """Return the power of a point by the formula, the arms run in common sessions."""
    first, second = row["comparison"].split(" - ")
    return model.paired_power(pool[first], pool[second], row["sessions"], row["trials"])


def _policy(shares: Float64Array, law: model.Law, repeats: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return what a policy's sessions are like, and what a test that ignores them does."""
    trials = PAPER_TRIALS * DEPTHS
    return {
        "share": law.share,
        "intraclass": law.intraclass,
        "session_sd": float(shares.mean(axis=1).std(ddof=1)),
        "design_effect_300": model.design_effect(law.intraclass, trials),
        "worth_of_300": trials / model.design_effect(law.intraclass, trials),
        "false_alarms_of_300": false_alarms(shares, PAPER_TRIALS, 5 * repeats, rng),
    }


def _difference(pool: Mapping[str, Float64Array], first: str, second: str) -> dict[str, Any]:
    apart = (pool[first] - pool[second]).mean(axis=1)
    found = cluster_bootstrap(apart, np.random.default_rng(53))
    return {
        "first": first,
        "second": second,
        "difference": found.value,
        "ci": [found.low, found.high],
        "sd_over_sessions": float(apart.std(ddof=1)),
    }


def _needed(points: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the sessions from which on power is enough; none: not up to the most tried."""
    rows = []
    for first, second in COMPARISONS:
        name = f"{first} - {second}"
        for trials in TRIALS:
            line = [p for p in points if p["comparison"] == name and p["trials"] == trials]
            counts = [p["sessions"] for p in line]
            rows.append(
                {
                    "comparison": name,
                    "trials": trials,
                    **{
                        f"{key}_{round(100 * wanted)}": model.least_sessions(
                            counts, [p[key] for p in line], wanted
                        )
                        for key in ("power", "power_holm")
                        for wanted in (0.8, 0.9)
                    },
                }
            )
    return rows


def _paper(laws: Mapping[str, model.Law], repeats: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return what the published shares need, and what 300 trials of each strategy resolve."""
    base, better = PUBLISHED["fixed"]["overall"], PUBLISHED["human_strategy"]["overall"]
    trials = PAPER_TRIALS * DEPTHS
    rho = laws["fixed_average"].intraclass
    arms = model.Law(better, laws["markov"].intraclass), model.Law(base, rho)
    splits = {"independent trials": (1, trials, 0.0)} | {
        f"{count} session{'s' if count > 1 else ''} of {trials // count}": (count, trials // count, rho)
        for count in (1, 5, 20)
    }
    shares = np.round(np.arange(base, 1.0, 0.01), 3)
    simulated = {str(each): published_power(*arms, SESSIONS, each * DEPTHS, repeats, rng) for each in TRIALS}
    return {
        "fixed": base,
        "human_strategy": better,
        "intraclass": rho,
        "sessions": list(SESSIONS),
        "power_by_trials_per_depth": simulated,
        "needed": {
            each: {str(w): model.least_sessions(SESSIONS, powers, w / 100) for w in (80, 90)}
            for each, powers in simulated.items()
        },
        "shares": shares.tolist(),
        "power": {
            name: [model.formula_power(model.Law(float(s), r), model.Law(base, r), n, each) for s in shares]
            for name, (n, each, r) in splits.items()
        },
        "detectable": {
            name: {str(w): model.detectable(base, r, n, each, power=w / 100) for w in (80, 90)}
            for name, (n, each, r) in splits.items()
        },
    }


def _human(repeats: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return the subjects needed to see the published depth effect; their correlation is assumed."""
    shares = [right / HUMAN_OF for right in HUMAN_RIGHT.values()]
    subjects = (SUBJECTS, 8, 10, 12, 16, 20, 24, 32, 40, 60)
    lines = {
        f"{rho:g}": depth_power(shares, rho, subjects, SUBJECT_TRIALS, repeats, rng)
        for rho in (0.0, 0.05, 0.1, 0.2)
    }
    own = sum(HUMAN_RIGHT.values()) / (HUMAN_OF * len(HUMAN_RIGHT))
    return {
        "subjects": list(subjects),
        "trials_per_depth": SUBJECT_TRIALS,
        "power_by_intraclass": lines,
        "needed": {
            rho: {str(w): model.least_sessions(subjects, powers, w / 100) for w in (80, 90)}
            for rho, powers in lines.items()
        },
        "share": own,
        "detectable_by_intraclass": {
            rho: model.detectable(own, float(rho), SUBJECTS, SUBJECT_TRIALS * len(shares)) for rho in lines
        },
    }
