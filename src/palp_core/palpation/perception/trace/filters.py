"""The model by which a belief follows a sweep, as a method of the register: task ``trace_filter``."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from palp_core.methods import find
from palp_core.palpation.perception.belief.rig_noise import on_depths
from palp_core.palpation.perception.trace.model import Stays, TraceModel
from palp_core.palpation.perception.trace.texture import Texture, fit_texture
from palp_core.palpation.perception.trace.training import TrainedTraces, sticking
from palp_core.units import Float64Array

FEW = 4
"""Mountings, of classes with several, from which a texture is fitted; from fewer it is assumed."""
UNREAD_N_M = 1.0
"""Spread of a bin that says nothing."""


@dataclass(frozen=True, eq=False)
class TraceKnowledge:
    """What is known of a rig in addition to what its training taught: how sweeps differ, and by how much."""

    sd: Float64Array  # Spread of each offset, in its unit, shape (l,)
    stays: tuple[Stays, ...]  # How long each stays
    mean_n_m: Float64Array  # The trace by the mechanics, shape (m, k, b)
    slope: Float64Array  # Its change by a unit of each offset, shape (m, k, b, l)
    bend: Float64Array  # What the offset's square adds, shape (m, k, b, l)
    slope_error: float  # What slopes are taken to be wrong by, relative
    texture: Texture  # What the surface adds along a track, where training does not show it
    # Where the ball touches in each bin, shape (m, k, b): where it does not move, it sticks
    place_m: Float64Array

    def with_squares(self) -> TraceKnowledge:
        """Return it with the squares of those offsets whose answer bends as further offsets.

        The square of a normal number of spread s has the spread sqrt(2) s^2 about its mean, which training's
        own mean has in it.
        """
        which = [i for i in range(len(self.sd)) if self.bend[..., i].any()]
        return replace(
            self,
            sd=np.concatenate([self.sd, 2**0.5 * self.sd[which] ** 2]),
            stays=(*self.stays, *(self.stays[i] for i in which)),
            slope=np.concatenate([self.slope, self.bend[..., which]], axis=-1),
        )


def second_order(trained: TrainedTraces, known: TraceKnowledge) -> TraceModel:
    """Return a model in which squares of offsets are offsets of their own.

    A trial's offset counts against the mean of those that training had: of few mountings, or landings, its
    variance is larger by their share. So is the texture's.
    """
    offsets = known.with_squares()
    share = np.sqrt(1.0 + 1.0 / trained.mountings)[:, None]
    slope = offsets.slope.copy()
    for number, stays in enumerate(offsets.stays):
        scale = np.sqrt(1.0 + 1.0 / trained.landings) if stays != "trial" else share
        slope[..., number] *= scale[..., None]
    unread = np.array([np.diag(np.where(held, UNREAD_N_M**2, 0.0)) for held in sticking(known.place_m)])
    more = float(np.sqrt(1.0 + 1.0 / trained.mountings.min()))
    return TraceModel(
        trained.mean,
        slope,
        offsets.sd,
        offsets.stays,
        trained.scatter + unread,
        replace(known.texture, sd_n_m=known.texture.sd_n_m * more),
        known.place_m,
        known.slope_error,
    )


@dataclass(frozen=True, eq=False)
class DepthGrid:
    """Depths to decide among that are not those of training."""

    depths_m: Float64Array  # The depths, increasing, within the trained range
    known: TraceKnowledge  # What TraceKnowledge says there


def model_of(
    name: str, trained: TrainedTraces, known: TraceKnowledge, grid: DepthGrid | None = None
) -> TraceModel:
    """Return the model of a method of task ``trace_filter``.

    The texture is that of training's mountings where there are several, else the one that is assumed.
    """
    texture = _texture(trained, known)
    if grid is not None:
        trained, known = _between(trained, known, grid), grid.known
    model: TraceModel = find("trace_filter", name).target(trained, replace(known, texture=texture))
    return model


def _texture(trained: TrainedTraces, known: TraceKnowledge) -> Texture:
    """Return the texture of the mountings at the stiffest ring, or the assumed one."""
    if len(trained.between) < FEW:
        return known.texture
    of, stiffest, offsets = trained.between_class, len(trained.rings_m) - 1, known.with_squares()
    shrunk = np.sqrt(
        1.0 - 1.0 / trained.mountings[of]
    )  # a mounting is part of the mean that it is held against
    return fit_texture(
        trained.between[:, stiffest] / shrunk[:, None],
        offsets.slope[of, stiffest],
        offsets.sd,
        trained.scatter[stiffest] * trained.mountings.max() / trained.landings[:, stiffest].min(),
        known.place_m[of, stiffest],
    )


def _between(trained: TrainedTraces, known: TraceKnowledge, grid: DepthGrid) -> TrainedTraces:
    """Return training at other depths: the mechanics' traces there, and over them what training adds.

    A trace changes its form with depth more than a curve through a few depths shows; what training differs by
    from the mechanics changes slowly.
    """
    added = on_depths(trained.mean - known.mean_n_m, trained.depths_m, grid.depths_m)
    count = grid.depths_m.size
    return replace(
        trained,
        depths_m=grid.depths_m,
        mean=grid.known.mean_n_m + added,
        mountings=np.full(count, trained.mountings.min()),
        landings=np.tile(trained.landings.min(axis=0), (count, 1)),
    )
