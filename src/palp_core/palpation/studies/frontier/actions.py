"""The study ``actions``: what it is worth to choose more than the ring, and to look a second time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.palpation.perception.statistics.resampling import cluster_bootstrap, share_interval
from palp_core.palpation.perception.statistics.statistics import calibration
from palp_core.palpation.perception.strategy.figure5 import DEPTHS_M
from palp_core.palpation.perception.trace.actions import SweepAction
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.reporting.table import write_records
from palp_core.palpation.session.operating.orders import GROUPED
from palp_core.palpation.session.plan import Specimens
from palp_core.palpation.studies.frontier.action_charts import action_chart, look_chart
from palp_core.palpation.studies.frontier.action_trials import (
    INDENTATIONS_M,
    SPEEDS_M_PER_S,
    ActionOutcomes,
    action_set,
    offer,
    run_action_trials,
    time_of,
)
from palp_core.palpation.studies.frontier.mismatch import sessions_of
from palp_core.palpation.studies.frontier.protocols import SWIFT
from palp_core.palpation.studies.frontier.schemes import SURE
from palp_core.palpation.studies.frontier.second_look import LOOKS, LookOutcome, second_looks
from palp_core.palpation.studies.frontier.world_session import WorldJob, worlds
from palp_core.palpation.studies.simulation.policy_summary import paired, summarise
from palp_core.palpation.studies.toolkit.parallel import run_jobs, seeds
from palp_core.palpation.world.model import LAB
from palp_core.whole_file import write_json

STIFFEST, RING, ALL = "stiffest ring", "ring", "all"
DIRECTION = frozenset({"direction"})
SCHEMES: dict[str, frozenset[str]] = {
    STIFFEST: frozenset(),
    RING: frozenset(),
    **{f"{RING}, {name}": frozenset({name}) for name in ("direction", "path", "speed", "indentation")},
    ALL: frozenset({"direction", "path", "speed", "indentation"}),
}
"""What may be chosen for each sweep."""
ROUGH = replace(LAB, name="lab, rough", texture_sd_n_m=0.5e-3)
"""A world of second looks alone: a surface of 0.5 N mm is the roughest that is assumed of cast silicone."""


@dataclass(frozen=True, eq=False)
class ActionSession:
    """What came of a session.

    Attributes:
        runs: By scheme; none in a world of second looks alone.
        looks: By second look.
        refused: Actions that no scheme was offered, with the reason.
        choosing_s: Seconds of one core that the scheme of all actions took a trial, all trials together.
    """

    runs: dict[str, ActionOutcomes]
    looks: dict[str, LookOutcome]
    refused: dict[SweepAction, str]
    choosing_s: float


def action_session(job: WorldJob) -> ActionSession:
    """Return what every scheme did in a session, and what second looks told."""
    session = sessions_of(job.plan, job.seed)(SWIFT)
    rig, rings_m = time_of(SWIFT), session.rings_m
    wanted = {
        name: action_set(rings_m[-1:] if name == STIFFEST else rings_m, varied).actions
        for name, varied in SCHEMES.items()
    }
    schemes = tuple(SCHEMES) if job.plan.world != ROUGH else ()
    known = offer(session, wanted[ALL] if schemes else action_set(rings_m[-1:], DIRECTION).actions)
    runs: dict[str, ActionOutcomes] = {}
    choosing_s = 0.0
    for name in schemes:
        before = session.simulating.outside()
        runs[name] = run_action_trials(session, known.only(wanted[name]), rig, threshold=SURE)
        spent_s = session.simulating.outside() - before
        choosing_s = spent_s / len(session.depth)
    first = SweepAction(rings_m[-1], INDENTATIONS_M[0], SPEEDS_M_PER_S[0], *SWIFT.path_m)
    return ActionSession(runs, second_looks(session, known, rig, first), dict(known.refused), choosing_s)


def scheme_rows(world: str, sessions: Sequence[ActionSession]) -> list[dict[str, Any]]:
    """Return a line per scheme, each against the ring alone."""
    rows = []
    for scheme in SCHEMES:
        runs = [one.runs[scheme] for one in sessions]
        ended = [one.ended for one in runs]
        line = summarise(ended, DEPTHS_M)
        seconds = cluster_bootstrap(
            [one.seconds.mean() for one in ended], np.random.default_rng(26), within=(0.0, np.inf)
        )
        against = paired(ended, [one.runs[RING].ended for one in sessions])
        rows.append(
            {
                "world": world,
                "scheme": scheme,
                **{key: line[key] for key in ("accuracy", "ci", "ece", "ece_ci", "probes", "undecided")},
                "seconds": seconds.value,
                "seconds_ci": [seconds.low, seconds.high],
                **{f"{key}_to_ring": value for key, value in against.items()},
                "first": first_asked(runs),
                "per_session": line["per_session"],
            }
        )
    return rows


def first_asked(runs: Sequence[ActionOutcomes]) -> list[dict[str, Any]]:
    """Return how often trials began with which sweep, the most frequent first."""
    asked: Counter[SweepAction] = Counter()
    for one in runs:
        for (probe, action), count in one.asked.items():
            asked[action] += count if probe == 0 else 0
    total = sum(asked.values())
    return [
        {
            "share": count / total,
            "ring_m": action.ring_m,
            "indentation_m": action.indentation_m,
            "speed_m_per_s": action.speed_m_per_s,
            "from_m": action.from_m,
            "to_m": action.to_m,
        }
        for action, count in asked.most_common(4)
        if count
    ]


def look_rows(world: str, sessions: Sequence[ActionSession]) -> list[dict[str, Any]]:
    """Return a line per second look: what is still missing, and what it took to learn the rest."""
    rows = []
    once = np.array([one.looks[LOOKS[0]].missing_bits.mean() for one in sessions])
    for name in LOOKS:
        looks = [one.looks[name] for one in sessions]
        rng = np.random.default_rng(27)
        right = share_interval([one.right for one in looks], rng)
        missing = np.array([one.missing_bits.mean() for one in looks])
        left = cluster_bootstrap(missing, rng, within=(0.0, np.inf))
        told = cluster_bootstrap(once - missing, rng, within=(-np.inf, np.inf))
        stated = calibration(
            np.clip(np.concatenate([one.confidence for one in looks]), 0.0, 1.0),
            np.concatenate([one.right for one in looks]).tolist(),
        )
        more_s = looks[0].seconds - sessions[0].looks[LOOKS[0]].seconds
        rows.append(
            {
                "world": world,
                "look": name,
                "accuracy": right.value,
                "ci": [right.low, right.high],
                "ece": stated.expected_error,
                "missing_bits": left.value,
                "missing_ci": [left.low, left.high],
                "told_bits": told.value,
                "told_ci": [told.low, told.high],
                "more_seconds": more_s,
                "told_per_s": told.value / more_s if more_s > 0.0 else None,
            }
        )
    return rows


def run(
    out: Path,
    *,
    quick: bool = False,
    workers: int = 1,
    dask: str = "",
    seed: int = 1,
    mounting: str = GROUPED,
    specimens: Specimens = "same",
) -> Path:
    """Run every scheme and second look, write tables and charts, and return the page.

    Args:
        out: Folder for the files; made if missing.
        quick: Few sessions.
        workers: Local processes.
        dask: Address of a Dask scheduler instead.
        seed: Of the sessions.
        mounting: As of a launch file; see :func:`.worlds`.
        specimens: Likewise.
    """
    count = 2 if quick else 40
    plans = worlds(mounting, specimens)
    looked = {**plans, ROUGH.name: replace(plans["lab"], world=ROUGH)}
    jobs = [WorldJob(plan, one) for plan in looked.values() for one in seeds(28, seed, count)]
    found = run_jobs(action_session, jobs, label="sessions", workers=workers, dask=dask)
    by_world = {world: found[i * count : (i + 1) * count] for i, world in enumerate(looked)}
    rows = [row for world in plans for row in scheme_rows(world, by_world[world])]
    looks = [row for world, sessions in by_world.items() for row in look_rows(world, sessions)]
    reasons = Counter(why for one in found for why in one.refused.values())
    report: dict[str, Any] = {
        "quick": quick,
        "sessions": count,
        "mounting": mounting,
        "specimens": specimens,
        "rows": rows,
        "looks": looks,
        "refused": list(reasons),
        "choosing_s": {
            world: float(np.median([one.choosing_s for one in by_world[world]])) for world in plans
        },
    }
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "actions.json", report)
    pictures = [picture(chart, out) for chart in (action_chart(rows), look_chart(looks))]
    write_records(out / "actions.csv", [_flat(row) for row in rows])  # with more than is drawn
    write_records(out / "second_look.csv", looks)
    return write_page(
        out / "index.html",
        "studies/actions.html",
        **report,
        pictures=pictures,
    )


def _flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a line of a table: of the first sweeps the most frequent."""
    kept = {key: value for key, value in row.items() if key not in ("per_session", "first")}
    return kept | {f"first_{key}": value for key, value in row["first"][0].items()}
