"""Trials in which every sweep is chosen: ring, indentation, speed, path and direction."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palp_core.palpation.perception.trace.actions import ActionModel, SweepAction
from palp_core.palpation.perception.trace.belief import TraceBelief, along, begin_sweep, start
from palp_core.palpation.session.trace.action_time import ActionTime, RigStanding
from palp_core.palpation.session.trace.actions import ActionSet, action_model
from palp_core.palpation.studies.frontier.protocols import SWIFT, Protocol
from palp_core.palpation.studies.frontier.trace_trials import (
    BIN_M,
    MOST,
    coarse,
    first_sure,
    learnt_of,
    outcomes,
    settings_of,
)
from palp_core.palpation.studies.frontier.world_session import WorldSession
from palp_core.palpation.studies.simulation.reading_table import SPEED_M_PER_S, scene_of
from palp_core.palpation.studies.simulation.trials import Outcomes
from palp_core.units import Float64Array

LOW_M, HIGH_M = (-0.026, -0.016), (0.034, 0.024)
"""Where a path may begin and end: the ends of the swift one, and 10 mm within it."""
SPEEDS_M_PER_S = (SPEED_M_PER_S, 0.040)
"""The paper's and twice of it; the safety node stops a stage beyond 0.05. Of half of it no more bits are
promised, in more seconds."""
INDENTATIONS_M = (0.004, 0.003, 0.0045)
"""That of training, and what the ball of 6 mm, at its smallest, still enters with the highest surface."""


def action_set(rings_m: tuple[float, ...], varied: frozenset[str]) -> ActionSet:
    """Return what may be chosen.

    Args:
        rings_m: Positions of the ring.
        varied: What beside the ring: ``direction``, ``path``, ``speed``, ``indentation``.
    """
    on = [(a, b) for a in LOW_M for b in HIGH_M] if "path" in varied else [SWIFT.path_m]
    back = [(b, a) for a, b in on] if "direction" in varied else []
    return ActionSet(
        rings_m,
        INDENTATIONS_M if "indentation" in varied else INDENTATIONS_M[:1],
        SPEEDS_M_PER_S if "speed" in varied else SPEEDS_M_PER_S[:1],
        tuple((round(a, 9), round(b, 9)) for a, b in (*on, *back)),
    )


def offer(session: WorldSession, actions: Sequence[SweepAction]) -> ActionModel:
    """Return what sweeps look like after the session's training, by the nominal scene."""
    settings, gel = settings_of(session), session.plan.gel
    learnt = learnt_of(session, settings)
    return action_model(settings, learnt, actions, scene=scene_of(gel, gel.depths_m[0]))


def time_of(protocol: Protocol) -> ActionTime:
    """Return the rig's times under a protocol."""
    return ActionTime(protocol.stage, protocol.timing)


@dataclass(frozen=True, eq=False)
class ActionOutcomes:
    """How trials ended whose sweeps were chosen.

    Attributes:
        ended: As of any trials.
        asked: How often each action was made, and as which sweep of a trial.
    """

    ended: Outcomes
    asked: Counter[tuple[int, SweepAction]]


@dataclass(frozen=True, eq=False)
class _Alike:
    """Trials that were swept alike: what they know and where the rig is."""

    trials: NDArray[np.int64]
    belief: TraceBelief
    at: RigStanding
    error_m: Float64Array


def run_action_trials(
    session: WorldSession,
    known: ActionModel,
    rig: ActionTime,
    *,
    threshold: float = 0.99,
    most: int = MOST,
) -> ActionOutcomes:
    """Run every trial to its verdict within a sweep, each sweep that of the most bits a second.

    Args:
        session: The trials.
        known: What may be asked for, and what it is expected to tell.
        rig: Its times.
        threshold: Belief at which a trial ends.
        most: Sweeps after which it is undecided.
    """
    count, m = len(session.depth), known.model.class_count
    end = np.full((count, m), 1.0 / m)
    probes, moves = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    seconds, decided = np.zeros(count), np.zeros(count, dtype=bool)
    asked: Counter[tuple[int, SweepAction]] = Counter()
    groups = [_Alike(np.arange(count), start(known.model, count), RigStanding(), np.zeros(count))]
    for probe in range(most):
        following: list[_Alike] = []
        for group in groups:
            choice, _ = known.best(group.belief, group.at.ring_m, rig.seconds(known.offered, group.at))
            for number in np.unique(choice):
                here, action = choice == number, known.offered[number]
                some, landed = group.trials[here], rig.lands(action, group.at)
                error_m = session.landings_m[some, probe] if landed else group.error_m[here]
                asked[probe, action] += len(some)
                moves[some] += int(landed and group.at.ring_m is not None)
                belief = begin_sweep(group.belief[here], known.setting[number], landed=landed)
                felt = coarse(session.swept(action, some, error_m, probe))[:, : known.bins[number]]
                after, posterior = along(known.model, belief, felt)
                halt, last = first_sure(posterior.max(axis=2) >= threshold)
                end[some] = posterior[np.arange(len(some)), last]
                probes[some], decided[some] = probe + 1, halt
                way_m = np.asarray((last + 1) * BIN_M, dtype=np.float64)
                seconds[some] += rig.to_s(action, group.at) + rig.sweep_s(action, way_m)
                over = halt | (probe + 1 == most)
                seconds[some[over]] += rig.home_s(action, way_m[over], group.at)
                if not over.all():
                    kept = ~over
                    at = rig.after(action, group.at)
                    following.append(_Alike(some[kept], after[kept], at, error_m[kept]))
        groups = following
        if not groups:
            break
    depths_m = np.asarray(session.depths_m)
    return ActionOutcomes(outcomes(session, depths_m, end, probes, moves, seconds, decided), asked)
