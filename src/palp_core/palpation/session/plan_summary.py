"""Run a plan dry: how much it asks for, and how long it takes at the least."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.palpation.session.plan import (
    BeginTrial,
    ExperimentDesign,
    MountPhantom,
    Palpate,
    Rehome,
    StepReply,
    experiment,
)


@dataclass(frozen=True)
class Pace:
    """Speeds and distances that bound a plan's duration from below.

    Attributes:
        sweep_m: Length of a sweep (assumed).
        sweep_m_per_s: Speed of a sweep; 20 mm/s as published.
        return_m_per_s: Speed of the way back (assumed equal), over at least the same length.
        ring_m_per_s: Speed of the ring's actuator; 6.5 mm/s without load by its data sheet.
        mount_s: Time to change a phantom (assumed).
    """

    sweep_m: float = 0.08
    sweep_m_per_s: float = 0.02
    return_m_per_s: float = 0.02
    ring_m_per_s: float = 0.0065
    mount_s: float = 60.0


@dataclass(frozen=True)
class Summary:
    """Counts of a plan and a lower bound of its duration.

    Attributes:
        training_palpations: Palpations with the depth told.
        estimation_palpations: Palpations without, at the assumed number per trial.
        trial_count: Trials of both phases.
        mount_count: Phantoms put on.
        rehome_count: Homings of the ring.
        ring_move_count: Changes of the ring's position that the plan itself asks for; a policy's come on top.
        least_duration_s: Sum of sweeps, returns, mounts and the plan's ring travel; no thinking, settling or
            policy.
    """

    training_palpations: int
    estimation_palpations: int
    trial_count: int
    mount_count: int
    rehome_count: int
    ring_move_count: int
    least_duration_s: float


def summarise(
    design: ExperimentDesign, rng: np.random.Generator, *, probes_per_trial: int = 1, pace: Pace | None = None
) -> Summary:
    """Run a plan dry and count.

    Args:
        design: The experiment's numbers.
        rng: Draws the order.
        probes_per_trial: Palpations until the verdict in every estimation trial.
        pace: Speeds and distances; the defaults of :class:`Pace` where not given.

    Raises:
        PerceptionError: ``probes_per_trial`` is less than 1.
    """
    if probes_per_trial < 1:
        raise PerceptionError(f"probes_per_trial is {probes_per_trial}; a verdict needs at least one")
    pace = pace or Pace()
    palpations = {True: 0, False: 0}
    trials = mounts = rehomes = moves = 0
    ring_m, travel_m = 0.0, 0.0
    plan = experiment(design, rng)
    step = next(plan, None)
    while step is not None:
        reply = StepReply("done")
        match step:
            case MountPhantom():
                mounts += 1
            case BeginTrial():
                trials += 1
            case Rehome():
                rehomes += 1
                travel_m, ring_m = travel_m + ring_m, 0.0
            case Palpate():
                palpations[step.ring_given] += 1
                if not step.ring_given:
                    reply = StepReply("decided" if step.iteration >= probes_per_trial else "continue")
                elif step.ring_m != ring_m:
                    moves += 1
                    travel_m, ring_m = travel_m + abs(step.ring_m - ring_m), step.ring_m
        try:
            step = plan.send(reply)
        except StopIteration:
            step = None
    sweep_s = pace.sweep_m / pace.sweep_m_per_s + pace.sweep_m / pace.return_m_per_s
    least_s = sum(palpations.values()) * sweep_s + travel_m / pace.ring_m_per_s + mounts * pace.mount_s
    return Summary(palpations[True], palpations[False], trials, mounts, rehomes, moves, float(least_s))
