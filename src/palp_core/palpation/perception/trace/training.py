"""What training teaches about whole sweeps: a mean trace a cell, its answer to the ring, a bin's scatter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.trace.model import Stays, TraceModel
from palp_core.palpation.perception.trace.texture import Texture
from palp_core.units import Float64Array

UNREAD_N_M = 1.0
"""Spread of a bin that says nothing."""
_HELD = 1.25


@dataclass(frozen=True, eq=False)
class TrainedTraces:
    """Mean traces of the cells, each mounting counting alike.

    Attributes:
        depths_m: Of the classes, increasing, shape (m,).
        rings_m: Of the settings, increasing, shape (k,).
        mean: N m, shape (m, k, b).
        mountings: Of each class, shape (m,).
        landings: Of each cell, shape (m, k).
        scatter: Covariance of a sweep's bins about its cell and mounting, N^2 m^2, shape (k, b, b), by ring,
            once the landing's part is taken out: what is new with every sweep, noise and stick-slip say.
        between: Mean traces of mountings less those of their class, shape (r, k, b); none where every class
            was mounted once.
        between_class: Class of each, shape (r,).
        repeats: Sweeps of each of those less its mean, as many as there are in the cell with the fewest,
            shape (r, k, repeats, b).
    """

    depths_m: Float64Array
    rings_m: Float64Array
    mean: Float64Array
    mountings: NDArray[np.int64]
    landings: NDArray[np.int64]
    scatter: Float64Array
    between: Float64Array
    between_class: NDArray[np.int64]
    repeats: Float64Array

    @property
    def ring_slope(self) -> Float64Array:
        """Change of the mean traces per metre of ring, by their own curve over the rings, shape (m, k, b)."""
        if len(self.rings_m) < 2:
            return np.zeros_like(self.mean)
        order: int = 2 if len(self.rings_m) > 2 else 1  # of the ends
        return np.asarray(np.gradient(self.mean, self.rings_m, axis=1, edge_order=order))  # type: ignore[call-overload]


def learn(
    traces_n_m: Float64Array,
    depth_m: Sequence[float],
    ring_m: Sequence[float],
    mounting: Sequence[int],
    *,
    floor_n_m: float,
) -> TrainedTraces:
    """Return what training sweeps teach.

    Args:
        traces_n_m: Their torques by position, shape (p, b).
        depth_m: Depth of each, length p.
        ring_m: Ring position of each, length p.
        mounting: Number of the mounting that each was felt in, length p.
        floor_n_m: Least scatter of a bin: what the sensor's steps make of it.

    Raises:
        PerceptionError: A cell without a sweep, or a torque that is not finite.
    """
    felt = np.asarray(traces_n_m, dtype=np.float64)
    if felt.ndim != 2 or not np.isfinite(felt).all():
        raise PerceptionError("training sweeps differ in length, or hold a NaN; drop those")
    depths_m, depth = np.unique(np.asarray(depth_m, dtype=np.float64), return_inverse=True)
    rings_m, ring = np.unique(np.asarray(ring_m, dtype=np.float64), return_inverse=True)
    _, mounted = np.unique(np.asarray(mounting), return_inverse=True)
    shape = (len(depths_m), len(rings_m), felt.shape[1])
    mean, landings = np.zeros(shape), np.zeros(shape[:2], dtype=np.int64)
    mountings = np.array([len(np.unique(mounted[depth == d])) for d in range(shape[0])], dtype=np.int64)
    scattered: list[tuple[int, int, Float64Array]] = []
    of_mounting: dict[tuple[int, int], Float64Array] = {}
    swept: dict[tuple[int, int], list[Float64Array]] = {}
    for d, r in np.ndindex(shape[:2]):
        here = (depth == d) & (ring == r)
        if not here.any():
            raise PerceptionError(
                f"no training at depth {depths_m[d] * 1e3:g} mm and ring {rings_m[r] * 1e3:g} mm; feel every "
                "cell"
            )
        landings[d, r] = int(here.sum())
        means = []
        for number in np.unique(mounted[here]):
            own = felt[here & (mounted == number)]
            means.append(own.mean(axis=0))
            of_mounting.setdefault((d, int(number)), np.full(shape[1:], np.nan))[r] = means[-1]
            swept.setdefault((d, int(number)), []).append(own - means[-1])
            if len(own) > 1:
                scattered.append((d, r, own - means[-1]))
        mean[d, r] = np.mean(means, axis=0)
    several = [
        one for one, found in of_mounting.items() if mountings[one[0]] > 1 and np.isfinite(found).all()
    ]
    fewest = min((len(own) for one in several for own in swept[one]), default=0)
    trained = TrainedTraces(
        depths_m,
        rings_m,
        mean,
        mountings,
        landings,
        np.tile(floor_n_m**2 * np.eye(shape[2]), (shape[1], 1, 1)),
        np.array([of_mounting[one] - mean[one[0]] for one in several]).reshape(len(several), *shape[1:]),
        np.array([d for d, _ in several], dtype=np.int64),
        np.array([[own[:fewest] for own in swept[one]] for one in several]).reshape(
            len(several), shape[1], fewest, shape[2]
        ),
    )
    return _with_scatter(trained, scattered, floor_n_m)


def _with_scatter(
    trained: TrainedTraces, scattered: list[tuple[int, int, Float64Array]], floor_n_m: float
) -> TrainedTraces:
    """Return it with what sweeps of a cell scatter by, beside what a landing makes of them."""
    slope, scatter = trained.ring_slope, trained.scatter.copy()
    for ring in range(len(scatter)):
        rests, freedom = [], 0
        for d, r, rest in scattered:
            if r == ring:
                along = slope[d, r]
                length = float(along @ along)
                rests.append(rest - np.outer(rest @ along / length, along) if length > 0.0 else rest)
                freedom += len(rest) - 1
        if freedom:
            found = shrunk_covariance(np.concatenate(rests), freedom)
            low = np.maximum(floor_n_m**2 - np.diag(found), 0.0)
            scatter[ring] = found + np.diag(low)
    return replace(trained, scatter=scatter)


def shrunk_covariance(rests: Float64Array, freedom: int) -> Float64Array:
    """Return a covariance from few rows, drawn towards its own diagonal as far as chance makes it differ.

    Schaefer and Strimmer, Statistical Applications in Genetics and Molecular Biology 4 (2005): the share is
    the summed variance of the off-diagonal entries over their summed squares, here of correlations.

    Args:
        rests: Rows about their own means, shape (n, b).
        freedom: Rows less the means that were taken out.
    """
    sd = np.sqrt((rests**2).sum(axis=0) / freedom)
    unit = rests / np.where(sd > 0.0, sd, 1.0)
    count = len(rests)
    products = unit[:, :, None] * unit[:, None, :]
    mean = products.mean(axis=0)
    variance = ((products - mean) ** 2).sum(axis=0) * count / max((count - 1) ** 3, 1)
    off = ~np.eye(rests.shape[1], dtype=bool)
    squares = float((mean[off] ** 2).sum())
    share = min(1.0, float(variance[off].sum()) / squares) if squares > 0.0 else 1.0
    correlation = np.where(off, (1.0 - share) * mean * count / freedom, 1.0)
    return np.asarray(correlation * np.outer(sd, sd))


def sticking(place_m: Float64Array) -> NDArray[np.bool_]:
    """Return in which bins of each setting the tip may still stick, shape (k, b), from its nominal places.

    Where it breaks loose the torque has a kink, to whose place it does not answer in a straight line. A tip
    that sticks rolls on the spot, by far less than the stage goes; one that is held longer than the nominal
    one is let go within a quarter more of the way.
    """
    steps = np.abs(np.diff(place_m, axis=2))
    slides = steps > 0.5 * np.median(steps, axis=2, keepdims=True)
    begun = np.argmax(slides, axis=2).max(axis=0)  # the last bin in which any class's tip sticks
    return np.asarray(np.arange(place_m.shape[2]) < np.ceil(_HELD * begun)[:, None])


@dataclass(frozen=True, eq=False)
class TraceOffsets:
    """What a sweep answers to beside depth and ring, and how much of it there is.

    Attributes:
        names: One each.
        sd: Spread of each, in its unit, shape (l,).
        stays: How long each stays.
        slope: Change of the trace by a unit of each by the mechanics, shape (m, k, b, l).
        slope_error: What slopes are taken to be wrong by, relative (assumed: a fifth).
    """

    names: tuple[str, ...]
    sd: Float64Array
    stays: tuple[Stays, ...]
    slope: Float64Array
    slope_error: float = 0.2


def trace_model(
    trained: TrainedTraces, offsets: TraceOffsets, texture: Texture, place_m: Float64Array
) -> TraceModel:
    """Return the model of a trial's sweeps by what training taught and what is known of the rig.

    A trial's offset counts against the mean of those that training had: of few mountings, or landings, its
    variance is larger by their share.

    Args:
        trained: Mean traces of the cells.
        offsets: What else a sweep answers to.
        texture: Of a track; training's part in it too.
        place_m: Where the ball touches in each bin, shape (m, k, b).
    """
    share = np.sqrt(1.0 + 1.0 / trained.mountings)[:, None]
    slope = offsets.slope.copy()
    for number, stays in enumerate(offsets.stays):
        scale = np.sqrt(1.0 + 1.0 / trained.landings) if stays != "trial" else share
        slope[..., number] *= scale[..., None]
    classes = len(trained.depths_m)
    unread = np.array([np.diag(np.where(held, UNREAD_N_M**2, 0.0)) for held in sticking(place_m)])
    return TraceModel(
        np.arange(classes),
        np.zeros(classes),
        trained.mean,
        slope,
        offsets.sd,
        offsets.stays,
        trained.scatter + unread,
        Texture(
            texture.sd_n_m * float(np.sqrt(1.0 + 1.0 / trained.mountings.min())),
            texture.length_m,
            texture.reversing,
            texture.form,
        ),
        place_m,
        np.zeros(len(trained.rings_m), dtype=bool),
        offsets.slope_error,
        offsets.names,
    )
