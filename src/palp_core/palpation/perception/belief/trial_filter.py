"""The belief of one trial from its readings, for the node and the re-analysis.

A trial has few probes, so the belief is always made from all of them. What a replacement node inherits is
then the list of probes, and the same list gives the same belief to the last bit wherever it is filtered.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np

from palp_core.errors import PerceptionError
from palp_core.methods import find
from palp_core.palpation.perception.belief import bayes, latent
from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.palpation.perception.belief.rig_noise import RigNoise, latent_model, on_depths
from palp_core.units import Float64Array

NAIVE = "naive"
MOST_DEPTHS = 1000
DepthCount = Annotated[int, msgspec.Meta(ge=0, le=MOST_DEPTHS)]
"""Depths of a grid: a thousand over the trained range are finer than any phantom is made."""


@dataclass(frozen=True)
class TrialReading:
    """A reading within a trial."""

    reading: float  # The feature of its sweep, in the unit of the primitives
    setting: int  # Index of the ring position
    landed: bool  # Whether the ring was moved, or re-homed, since the reading before


@dataclass(frozen=True, eq=False)
class TrialFilter:
    """What turns the readings of a trial into a belief.

    >>> from palp_core.palpation.perception.belief.primitives import fit
    >>> depths_m, felt = [0.002, 0.004], [1.0, 1.2, 2.0, 2.2]
    >>> taught = fit(felt, [0, 0, 1, 1], [0] * 4, depths_m=depths_m, rings_m=[0.008], floor=0.01)
    >>> trial_filter("naive", taught).posterior([TrialReading(1.1, 0, landed=True)]).round(2).tolist()
    [1.0, 0.0]

    Attributes:
        primitives: Of the classes that are decided among.
        model: Readings and what stays; None for the naive filter.
        likelihood: Method of task ``likelihood``; of the naive filter.
    """

    primitives: Primitives
    model: latent.OffsetModel | None
    likelihood: str

    def posterior(self, probes: Sequence[TrialReading]) -> Float64Array:
        """Return the probabilities of the classes after the probes of a trial, shape (m,).

        Raises:
            PerceptionError: A reading is not finite, or a setting was not trained.
        """
        if self.model is not None:
            return belief_after(self.model, probes).posterior
        log_belief = bayes.flat_prior(self.primitives.depths_m.size)
        for probe in probes:
            density = self.primitives.log_likelihood(probe.reading, probe.setting, model=self.likelihood)
            log_belief = bayes.update(log_belief, density)
        return bayes.posterior(log_belief)


def belief_after(model: latent.OffsetModel, probes: Sequence[TrialReading]) -> latent.Belief:
    """Return what is known of classes and offsets after the probes."""
    belief = latent.start(model)
    for probe in probes:
        belief = latent.update(model, belief, probe.reading, probe.setting, probe.landed)
    return belief


def classes_of(depths_m: Sequence[float], count: int) -> Float64Array:
    """Return the depths that are decided among: the trained ones, or a grid of ``count`` over their range."""
    if count == 0:
        return np.array(depths_m, dtype=np.float64)
    if count > MOST_DEPTHS:
        raise PerceptionError(f"a grid of {count} depths: it has at most {MOST_DEPTHS}")
    if count < 2 or len(depths_m) < 2:
        raise PerceptionError(
            f"a grid of {count} depths over {len(depths_m)} trained: at least two of both are needed"
        )
    return np.round(np.linspace(depths_m[0], depths_m[-1], count), 9)


def require_likelihood(name: str, likelihood: str) -> None:
    """Refuse a likelihood that the filter would not use, before anything was felt."""
    find("filter", name)
    find("likelihood", likelihood)
    if name != NAIVE and likelihood != "normal":
        raise PerceptionError(f"likelihood '{likelihood}' is of the filter 'naive'; '{name}' needs 'normal'")


def require_rings(name: str, ring_count: int) -> None:
    """Refuse a filter whose slope over ring positions training would not give."""
    if name != NAIVE and ring_count < 2:
        raise PerceptionError(
            f"filter '{name}' needs two trained ring positions; train more, or take '{NAIVE}'"
        )


def trial_filter(
    name: str,
    primitives: Primitives,
    *,
    likelihood: str = "normal",
    depth_count: int = 0,
    noise: RigNoise | None = None,
    height_slope: Float64Array | None = None,
) -> TrialFilter:
    """Return a filter of task ``filter``, over the trained depths or a grid.

    Args:
        name: ``naive``, eq. (7), or one that knows what stays.
        primitives: What training taught.
        likelihood: Method of task ``likelihood``; of the naive filter, the others are normal.
        depth_count: Depths of a grid between the shallowest and the deepest; 0 for the trained ones.
        noise: What stays, and how much; for all but the naive filter.
        height_slope: Change of the reading per metre of height at the trained depths, N m/m, shape (m, k).

    Raises:
        MethodError: No such filter.
        PerceptionError: The filter needs to know what stays, and that is missing.
    """
    chosen = find("filter", name)
    classes = classes_of(primitives.depths_m.tolist(), depth_count)
    fine = primitives if depth_count == 0 else primitives.interpolated(classes)
    if name == NAIVE:
        return TrialFilter(fine, None, likelihood)
    if noise is None or height_slope is None:
        raise PerceptionError(f"the filter '{name}' needs to know what stays: a noise file and a scene")
    slope = on_depths(height_slope, primitives.depths_m, classes)
    return TrialFilter(fine, chosen.target(latent_model(fine, noise, slope)), likelihood)
