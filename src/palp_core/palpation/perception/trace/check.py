"""Do the trials of a session differ from its training by more than mountings do?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.palpation.perception.trace.belief import TraceBelief, offsets
from palp_core.palpation.perception.trace.model import TraceModel
from palp_core.units import Float64Array


@dataclass(frozen=True)
class Shifted:
    """An offset that trials have on the whole and training had not.

    Attributes:
        offset: Its number.
        scores: How many of its own spreads it is off by, on average.
        p: Probability of so much or more of any offset, were there none.
    """

    offset: int
    scores: float
    p: float


def scores(model: TraceModel, belief: TraceBelief) -> Float64Array:
    """Return each trial's offsets in units of what they scatter by, shape (n, l); 0 for what is not felt.

    Those that stay for a trial, under each trial's most probable component; standard normal where trials
    differ from training by no more than mountings do.
    """
    best = np.argmax(belief.log_density + model.log_weight, axis=1)
    found = np.zeros((len(best), len(model.offset_sd)))
    of_trial = np.array([stays == "trial" for stays in model.stays])
    for component in np.unique(best):
        here = best == component
        mean, left = offsets(model, belief[here], int(component))
        told = np.sqrt(np.maximum(model.offset_sd**2 - left**2, 0.0))
        felt = of_trial & (told > 0.2 * model.offset_sd)
        found[here] = np.where(felt, mean / np.where(told > 0.0, told, 1.0), 0.0)
    return found


def shifted(found: Float64Array, shared: float) -> Shifted | None:
    """Return the offset by which the trials of a session differ most from training, if any was felt.

    Args:
        found: Scores of its trials, shape (n, l).
        shared: Share of a score's variance that all trials have in common: training's own mountings, 1 / (1 +
            s) of s.
    """
    felt: NDArray[np.bool_] = (found != 0.0).any(axis=0)
    if not felt.any():
        return None
    mean = found.mean(axis=0)
    spread = np.sqrt((1.0 - shared) / len(found) + shared)
    worst = int(np.argmax(np.where(felt, np.abs(mean), -1.0)))
    alone = 2.0 * float(scipy.stats.norm.sf(abs(mean[worst]) / spread))
    return Shifted(worst, float(mean[worst]), 1.0 - (1.0 - alone) ** int(felt.sum()))
