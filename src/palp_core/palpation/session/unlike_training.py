"""The run's own warning: its trials do not fit what training taught."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.palpation.perception.belief.session_check import (
    LOOK_P,
    MISFIT,
    Projected,
    SessionTrials,
    Shifted,
    shifted,
)

ADVICE = "check that gel, probe, indentation and ring are as they were in training, or train anew"
READING = "reading"
_LEAST_SD = 10.0  # spreads that a mean reading is above nothing, for shares of it to say something

_THINGS = {
    READING: "their readings",
    "height_m": "the surface's height",
    "modulus": "the gel's modulus",
    "friction": "the friction",
    "along_m": "the bead's place along the path",
    "beside_m2": "the bead's distance beside the path",
    "tip_radius_m": "the ball's radius",
}


def unlike_training(trials: SessionTrials, one: Projected | None, phantom: str) -> str:
    """Add a trial that is over to its session, and return what there is to tell of it: once, else nothing.

    Args:
        trials: The session's; keeps what was told.
        one: The trial; None where there is nothing to hold it against.
        phantom: Tells which trials are of the same phantom; all of them where nobody knows.
    """
    if one is None:
        return ""
    trials.add(one, phantom)
    if trials.told or not trials.due:
        return ""
    found = shifted(trials, one)
    if found is None or found.p >= LOOK_P:
        return ""
    trials.told = _words(trials.count, found)
    return trials.told


def _words(count: int, found: Shifted) -> str:
    fits = f"{count} trials do not fit what training taught (p = {found.p:.1g}): "
    if found.name == MISFIT:
        worse = "worse" if found.scores > 0.0 else "better"
        return f"{fits}they fit their classes {worse} than training's own mountings do"
    thing, more = _THINGS.get(found.name, found.name), "larger" if found.scores > 0.0 else "smaller"
    return f"{fits}on the whole it is as if {thing} were {more}"


def by_readings(
    memory: Primitives, probes: Sequence[tuple[float, int, bool]], of: int, ring_sd_m: float
) -> Projected | None:
    """Return a trial by the features of its sweeps: what they are off by, as a share of training's mean.

    Every class counts as mounted once in training. None where a reading is too near nothing to have shares.

    Args:
        memory: What training taught, of every class and ring.
        probes: Reading and index of the ring of each sweep, and whether the ring landed anew.
        of: The class that the trial was taken for.
        ring_sd_m: Spread of a landing.
    """
    mean, sd = memory.mean[of], memory.sd[of]
    kept = [(reading, ring) for reading, ring, _ in probes if mean[ring] > _LEAST_SD * sd[ring]]
    if not kept:
        return None
    slope = np.gradient(mean, memory.rings_m) if len(mean) > 1 else np.zeros(1)
    off = np.mean([reading / mean[ring] - 1.0 for reading, ring in kept])
    landing = ring_sd_m * np.mean([slope[ring] / mean[ring] for _, ring in kept])
    classes = np.ones(len(memory.depths_m), dtype=np.int64)
    return Projected((READING,), of, off.reshape(1, 1), landing.reshape(1), np.zeros((0, 1)), classes, 0.0)
