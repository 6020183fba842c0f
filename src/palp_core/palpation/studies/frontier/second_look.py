"""What a second look is worth after a whole first sweep: back, again, or landed anew."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palp_core.palpation.perception.trace.actions import ActionModel, SweepAction
from palp_core.palpation.perception.trace.belief import along, begin_sweep, start
from palp_core.palpation.session.trace.action_time import ActionTime, RigStanding
from palp_core.palpation.studies.frontier.trace_trials import coarse
from palp_core.palpation.studies.frontier.world_session import WorldSession
from palp_core.units import Float64Array

LOOKS = ("one look", "back", "again", "landed anew")
"""None; the same path back; the same path once more; the same, the ring at its stop in between."""


@dataclass(frozen=True, eq=False)
class LookOutcome:
    """What trials know after it.

    Attributes:
        right: Whether the most probable depth is the true one, shape (n,).
        confidence: Its probability, shape (n,).
        missing_bits: -log2 of the true depth's probability, shape (n,).
        seconds: From the trial's beginning to its end, the same for all.
    """

    right: NDArray[np.bool_]
    confidence: Float64Array
    missing_bits: Float64Array
    seconds: float


def second_looks(
    session: WorldSession, known: ActionModel, rig: ActionTime, first: SweepAction
) -> dict[str, LookOutcome]:
    """Return what each second look leaves unknown, all trials swept whole; nothing is stopped.

    Args:
        session: The trials.
        known: Which offers the first sweep and the same back.
        rig: Its times.
        first: The first sweep.
    """
    every, depth = np.arange(len(session.depth)), session.depth
    back = SweepAction(first.ring_m, first.indentation_m, first.speed_m_per_s, first.to_m, first.from_m)
    landing_m, anew_m = session.landings_m[:, 0], session.landings_m[:, 1]
    setting = {action: known.setting[known.offered.index(action)] for action in (first, back)}
    belief = begin_sweep(start(known.model, len(every)), setting[first], landed=True)
    felt = coarse(session.swept(first, every, landing_m, 0))[:, : known.model.bin_count]
    once, posterior = along(known.model, belief, felt)
    before_s = float(rig.seconds([first], RigStanding())[0])
    after = rig.after(first, RigStanding())
    found = {LOOKS[0]: _look(depth, posterior[:, -1], before_s)}
    for name, action, error_m in (
        (LOOKS[1], back, landing_m),
        (LOOKS[2], first, landing_m),
        (LOOKS[3], first, anew_m),
    ):
        anew = name == LOOKS[3]
        belief = begin_sweep(once, setting[action], landed=anew)
        felt = coarse(session.swept(action, every, error_m, 1))[:, : known.model.bin_count]
        _, posterior = along(known.model, belief, felt)
        seconds = before_s + float(rig.seconds([action], after)[0])
        seconds += float(rig.ring.renew_s(np.asarray(first.ring_m))) if anew else 0.0
        found[name] = _look(depth, posterior[:, -1], seconds)
    return found


def _look(depth: NDArray[np.int64], posterior: Float64Array, seconds: float) -> LookOutcome:
    own = np.take_along_axis(posterior, depth[:, None], axis=1)[:, 0]
    return LookOutcome(
        posterior.argmax(axis=1) == depth,
        posterior.max(axis=1),
        -np.log2(np.maximum(own, 1e-30)),
        seconds,
    )
