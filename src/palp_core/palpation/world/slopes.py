"""Binned traces of a scene, and how they answer to each latent, by whole solved sweeps: for a filter.

All of it follows from the scene file alone, so that a laboratory has it as well as a simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from palp_core.palpation.mechanics.scene.choice import choose_rung
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.world.drag import Dragged, drag
from palp_core.palpation.world.latents import LATENTS, LOWEST, REACH
from palp_core.palpation.world.touch import touch
from palp_core.units import Float64Array

NODE_M = 0.001
"""Stage positions at which a sweep is solved; a spline goes through them."""
FINE_M = 0.00025
"""Positions that a bin's mean is taken over."""
SMALL = 0.05
"""Of a latent's reach: the step of a slope, that of a tenth of a millimetre say."""


def bin_edges_m(from_m: float, to_m: float, width_m: float = 0.002) -> Float64Array:
    """Return rising edges of bins of a path; what is left over at its end is no bin."""
    count = int(np.floor(abs(to_m - from_m) / width_m + 1e-9))
    return np.asarray(min(from_m, to_m) + width_m * np.arange(count + 1))


@dataclass(frozen=True, eq=False)
class Bins:
    """From torques at the nodes of a sweep to means over bins of the stage position."""

    edges_m: Float64Array  # rising edges, shape (K + 1,)
    node_m: Float64Array  # stage positions in the sweep's order, shape (p,)
    fine_m: Float64Array  # where the torque is read between them, rising, shape (f,)
    spline: Float64Array  # from nodes to fine positions, shape (f, p)
    mean: Float64Array  # from fine positions to bins, shape (K, f)


def bins_of(edges_m: Float64Array, *, forward: bool = True) -> Bins:
    """Return the bins of a path that begins at the first edge, or at the last if it is swept back."""
    low, high = edges_m[0], edges_m[-1]
    rising = np.linspace(low, high, max(round((high - low) / NODE_M), 8) + 1)
    parts = max(round((edges_m[1] - edges_m[0]) / FINE_M), 1)
    fine_m = np.interp(np.arange((len(edges_m) - 1) * parts + 1) / parts, np.arange(len(edges_m)), edges_m)
    spline = scipy.interpolate.CubicSpline(rising, np.eye(len(rising)))(fine_m)
    weights = np.full(parts + 1, 1.0 / parts)
    weights[[0, -1]] *= 0.5
    mean = np.zeros((len(edges_m) - 1, len(fine_m)))
    for k in range(len(mean)):
        mean[k, k * parts : (k + 1) * parts + 1] = weights
    return Bins(
        edges_m, rising if forward else rising[::-1], fine_m, spline if forward else spline[:, ::-1], mean
    )


def binned(bins: Bins, found: Dragged, *, run_in: bool = True) -> Float64Array:
    """Return the mean torque of each bin, shape (n, K), of sweeps that were solved at the nodes."""
    slid = found.sliding_n_m @ bins.spline.T
    if run_in:
        held = found.sticking_n_m @ bins.spline.T
        way_m = np.abs(bins.fine_m - bins.node_m[0])
        slid = np.where(way_m < found.loose_m[:, None], held, slid)
    return np.asarray(slid @ bins.mean.T)


@dataclass(frozen=True, eq=False)
class TraceSlopes:
    """Nominal binned traces and their slopes: m depths, k rings, K bins, l latents."""

    mean_n_m: Float64Array  # nominal traces, shape (m, k, K)
    slope: Float64Array  # change per unit of each latent of .LATENTS, shape (m, k, K, l)
    # half the change of the slope per unit of each latent, shape (m, k, K, l): a parabola through the nominal
    # trace and those a step to either side; 0 for the square beside the path
    bend: Float64Array
    # mean place of the ball in each bin of the nominal sweep, shape (m, k, K): where it sticks it stays, and
    # past a bead it goes faster than the stage
    place_m: Float64Array


def trace_slopes(
    scene: Scene,
    depths_m: Sequence[float],
    rings_m: Sequence[float],
    edges_m: Float64Array | None = None,
    *,
    forward: bool = True,
    run_in: bool = True,
    steps: Float64Array | None = None,
) -> TraceSlopes:
    """Return what the binned trace of each depth and ring is, and how it answers to the latents.

    Slopes are differences over a step to either side: ``steps`` of each latent, shape (l,), as large as it is
    likely to be, or a twentieth of its reach; to the square beside the path from the scene's own on.
    ``edges_m`` are rising edges of bins, else of 2 mm over the path of the scene.
    """
    if edges_m is None:
        edges_m = bin_edges_m(scene.path.from_m, scene.path.to_m)
    bins = bins_of(edges_m, forward=forward)
    count = len(LATENTS)
    step = SMALL * REACH if steps is None else np.minimum(steps, REACH)
    low = np.where(LOWEST < 0.0, -step, 0.0)
    rows = np.concatenate([np.zeros((1, count)), np.diag(low), np.diag(step)])
    if scene.phantom.bead is not None:
        rows[:, LATENTS.index("beside_m2")] += scene.phantom.bead.beside_m**2
    width = np.maximum(step - low, 1e-12)
    many = len(rows)
    mean = np.empty((len(depths_m), len(rings_m), len(bins.mean)))
    slope, bend = np.empty((*mean.shape, count)), np.empty((*mean.shape, count))
    place_m = np.empty(mean.shape)
    for i, depth_m in enumerate(depths_m):
        own = scene.with_bead(depth_m)
        found = drag(
            touch(own.phantom, own.probe, choose_rung(own).rung),
            np.tile(rows, (len(rings_m), 1)),
            np.repeat(np.asarray(rings_m), many),
            own.path.indentation_m,
            bins.node_m,
            run_in=run_in,
        )
        traces = binned(bins, found, run_in=run_in).reshape(len(rings_m), many, -1)
        mean[i] = traces[:, 0]
        up, down = traces[:, 1 + count :], traces[:, 1 : 1 + count]
        slope[i] = np.moveaxis((up - down) / width[:, None], 1, -1)
        curve = np.where(low < 0.0, 0.5 / np.maximum(step, 1e-12) ** 2, 0.0)[:, None]
        bend[i] = np.moveaxis((up + down - 2.0 * traces[:, :1]) * curve, 1, -1)
        place_m[i] = found.tip_m[::many] @ bins.spline.T @ bins.mean.T
    return TraceSlopes(mean, slope, bend, place_m)
