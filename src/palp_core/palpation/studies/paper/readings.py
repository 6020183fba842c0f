"""The paper's question by other readings: peak, contrast and whole trace of the same sweeps, by both rules.

Schemes, worlds and sessions are those of the study ``frontier``, of which these are the first few.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from palp_core.palpation.studies.frontier.depth_error import DEPTH_SCHEMES, depth_errors
from palp_core.palpation.studies.frontier.schemes import SCHEMES, TRACE, Scheme, run_plan
from palp_core.palpation.studies.frontier.study import SEEDS
from palp_core.palpation.studies.frontier.tables import Runs, compared, depth_rows, scheme_rows
from palp_core.palpation.studies.paper.scenes import SCENES
from palp_core.palpation.studies.simulation.session import WorldPlan, worlds
from palp_core.palpation.studies.toolkit.parallel import Runner

SHOWN = tuple(one for one in SCHEMES if one.protocol == "paper" or one.reading == TRACE)
WORLDS = worlds()
_FIXED, _HUMAN = "fixed_best", "markov"


@dataclass(frozen=True)
class ReadingSize:
    """How much is run.

    Attributes:
        sessions: Sessions of either world and of each scene; 0 leaves all of it out.
        depth_sessions: Sessions of either world on 31 depths.
        trials: Trials per depth and session.
        scenes: Whether the scenes that were fixed in advance are run, too.
        schemes: Which.
    """

    sessions: int = 10
    depth_sessions: int = 4
    trials: int = 100
    scenes: bool = True
    schemes: tuple[Scheme, ...] = SHOWN


def by_readings(size: ReadingSize, runner: Runner) -> dict[str, Any]:
    """Return every scheme's accuracy and error of the depth, side by side, and what varying is worth.

    Args:
        size: How much is run.
        runner: Of the sessions.

    Returns:
        ``worth``: what varying is worth by contrast and by trace; ``places``, by world and scene: lines of
        :func:`side_by_side`; ``depths``: lines of :func:`.depth_rows`; the numbers of sessions. Empty where
        there are none.
    """
    if not size.sessions:
        return {}
    plans = {
        name: replace(plan, conditions=replace(plan.conditions, trials=size.trials))
        for name, plan in _plans(size.scenes).items()
    }
    session = partial(run_plan, schemes=size.schemes)
    found = runner.run(
        session, list(plans.values()), size.sessions, stream=SEEDS, label="sessions by reading"
    )
    places = {name: side_by_side(name, own) for name, own in zip(plans, found, strict=True)}
    depths = []
    if size.depth_sessions:
        errors = partial(depth_errors, schemes=tuple(one for one in size.schemes if one in DEPTH_SCHEMES))
        cases, label = list(WORLDS.values()), "sessions by reading, 31 depths"
        off = runner.run(errors, cases, size.depth_sessions, stream=SEEDS, label=label)
        depths = [row for name, own in zip(WORLDS, off, strict=True) for row in depth_rows(name, own)]
    return gathered(places, depths, sessions=size.sessions, depth_sessions=size.depth_sessions)


def gathered(
    places: Mapping[str, Sequence[Mapping[str, Any]]],
    depths: Sequence[Mapping[str, Any]],
    *,
    sessions: int,
    depth_sessions: int,
) -> dict[str, Any]:
    """Return what :func:`by_readings` does, of lines that are there."""
    return {
        "sessions": sessions,
        "depth_sessions": depth_sessions,
        "worth": _worth(places),
        "places": places,
        "depths": depths,
    }


def _plans(scenes: bool) -> dict[str, WorldPlan]:
    """Return the worlds, and the scenes in the paper's own, by name."""
    more = {name: replace(plan, gel=replace(plan.gel, reading="trace")) for name, plan in SCENES.items()}
    return WORLDS | (more if scenes else {})


def side_by_side(place: str, sessions: Runs) -> list[dict[str, Any]]:
    """Return a line per reading, rule and cycle: each policy's, and the human's less the best fixed one's.

    Args:
        place: World or scene.
        sessions: What each scheme did, a session each.
    """
    rows = {row["scheme"]: row for row in scheme_rows(place, sessions)}
    lines = []
    for way, schemes in _ways(rows):
        fixed, human = schemes.get(_FIXED), schemes.get(_HUMAN)
        lines.append(
            {
                "reading": way.reading,
                "rule": way.rule,
                "protocol": way.protocol,
                "policies": {policy: rows[one.name] for policy, one in schemes.items()},
                "human_less_fixed": compared(sessions, human, fixed) if fixed and human else None,
            }
        )
    return lines


def _ways(rows: Mapping[str, Any]) -> Iterator[tuple[Scheme, dict[str, Scheme]]]:
    """Give each way to read and to stop, and the schemes that have it by policy."""
    found: dict[Scheme, dict[str, Scheme]] = {}
    for one in SCHEMES:
        if one.name in rows:
            found.setdefault(replace(one, policy=""), {})[one.policy] = one
    yield from found.items()


def _worth(places: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[dict[str, Any]]:
    """Return what varying as people do gives over the best fixed position, once the right number is read."""
    return [
        {"world": name, "reading": line["reading"], **line["human_less_fixed"]}
        for name in WORLDS
        for line in places[name]
        if line["human_less_fixed"] and line["reading"] != "peak"
        if line["rule"] == "threshold" and line["protocol"] == "paper"
    ]
