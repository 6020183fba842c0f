"""What training teaches about whole sweeps: mean traces, their change with the ring, scatter by bin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.units import Float64Array

_HELD = 1.25


@dataclass(frozen=True, eq=False)
class TrainedTraces:
    """Mean traces of the cells, each mounting counting alike."""

    depths_m: Float64Array  # Of the classes, increasing, shape (m,)
    rings_m: Float64Array  # Of the settings, increasing, shape (k,)
    mean: Float64Array  # N m, shape (m, k, b)
    mountings: NDArray[np.int64]  # Of each class, shape (m,)
    landings: NDArray[np.int64]  # Of each cell, shape (m, k)
    # Covariance of a sweep's bins about its cell and mounting, N^2 m^2, shape (k, b, b), by ring, once the
    # landing's part is taken out: what is new with every sweep, noise and stick-slip say
    scatter: Float64Array
    # Mean traces of mountings less those of their class, shape (r, k, b); none where every class was mounted
    # once
    between: Float64Array
    between_class: NDArray[np.int64]  # Class of each, shape (r,)

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
    """Return what training sweeps teach."""
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
            if len(own) > 1:
                scattered.append((d, r, own - means[-1]))
        mean[d, r] = np.mean(means, axis=0)
    several = [
        one for one, found in of_mounting.items() if mountings[one[0]] > 1 and np.isfinite(found).all()
    ]
    trained = TrainedTraces(
        depths_m,
        rings_m,
        mean,
        mountings,
        landings,
        np.tile(floor_n_m**2 * np.eye(shape[2]), (shape[1], 1, 1)),
        np.array([of_mounting[one] - mean[one[0]] for one in several]).reshape(len(several), *shape[1:]),
        np.array([d for d, _ in several], dtype=np.int64),
    )
    return _with_scatter(trained, scattered, floor_n_m)


def _with_scatter(
    trained: TrainedTraces, scattered: list[tuple[int, int, Float64Array]], floor_n_m: float
) -> TrainedTraces:
    """Return it with what sweeps of a cell scatter by, without what a landing makes of them."""
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
