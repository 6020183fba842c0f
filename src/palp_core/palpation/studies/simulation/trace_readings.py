"""Whole sweeps at 1 kHz out of the table of traces, and what the paper's chain reads off them.

For comparing features with traces in one world: the same luck gives the binned trace and the reading.
De-noising and features are the chain's own, so that a reading is off by what the table misses of a sweep and
by no more: some 0.01 N mm, and 0.05 where there is a surface, met where the ball is on the nominal sweep.
"""

from __future__ import annotations

import functools

import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.methods import find
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.studies.simulation.reading_table import FROM_M, RATE_HZ, SPEED_M_PER_S, TO_M, Gel
from palp_core.palpation.studies.simulation.trace_table import (
    PHASES,
    TraceTable,
    latent_basis,
    stick_slip_at,
)
from palp_core.palpation.world.model import WorldModel
from palp_core.palpation.world.texture import bias, texture, texture_map
from palp_core.units import Float64Array

STAGE_M = np.arange(FROM_M, TO_M, SPEED_M_PER_S / RATE_HZ)
"""Stage positions of a sweep's samples, rising; a sweep back has them in the other order."""


def whole_sweeps(
    table: TraceTable,
    world: WorldModel,
    depth: NDArray[np.int64],
    ring: NDArray[np.int64],
    rows: Float64Array,
    luck: Float64Array,
    phase: Float64Array,
    rng: np.random.Generator,
    *,
    since_tare_s: float = 0.0,
    noise_sd_n_m: float = RESOLUTION_N_M,
) -> Float64Array:
    """Return measured sweeps in the order of time, N m, shape (n, samples): a few thousand at a time.

    Args:
        table: What is felt.
        world: What is on.
        depth: Class, shape (n,).
        ring: Index of the ring position, shape (n,).
        rows: Latents, shape (n, 7).
        luck: Tracks of the mountings, shape (n, 2, places).
        phase: Share of a cycle of stick-slip at the start, shape (n,).
        rng: Of the sensor: samples + 2 and samples standard normals a sweep are drawn.
        since_tare_s: Seconds from the last tare to the start of each sweep.
        noise_sd_n_m: Of a sample.
    """
    count, samples = len(depth), len(STAGE_M)
    zero = bias(world, rng.standard_normal((count, samples + 2)), 1.0 / RATE_HZ, since_tare_s)
    noise = noise_sd_n_m * rng.standard_normal((count, samples))
    made = np.empty((count, samples))
    cell = depth * len(table.gel.rings_m) + ring
    turn = np.rint(phase * PHASES).astype(np.int64) % PHASES
    for number in np.unique(cell):
        (here,) = np.nonzero(cell == number)
        i, j = divmod(int(number), len(table.gel.rings_m))
        true = _true(table, i, j, rows[here])
        if world.texture_sd_n_m > 0.0:
            spline = _spline(table.bins.node_m)
            surface = texture_map(world, spline @ table.tip_m[i, j])
            true += texture(world, luck[here], surface, forward=table.forward)
        if world.static_friction_excess > 0.0:
            true += _cycles(table.gel, table.forward, table.run_in, world.static_friction_excess)[
                i, j, turn[here]
            ]
        made[here] = true
    made = (made if table.forward else made[:, ::-1]) + zero + noise
    return np.asarray(np.rint(made / RESOLUTION_N_M) * RESOLUTION_N_M)


def readings(
    torque_n_m: Float64Array, feature: str = "peak", denoising: str = "soft_universal"
) -> Float64Array:
    """Return what is read off sweeps, N m, shape (n,); of a sweep back the torque's magnitude.

    Args:
        torque_n_m: Measured, in the order of time, shape (n, samples).
        feature: A method of task ``feature``.
        denoising: A method of task ``denoise``.
    """
    read = find("feature", feature).target
    edge = edge_cone()
    sign = np.where(np.median(torque_n_m, axis=1) < 0.0, -1.0, 1.0)
    return np.array(
        [float(read(denoise(one, rule=denoising), edge=edge).value_n_m) for one in sign[:, None] * torque_n_m]
    )


def _true(table: TraceTable, i: int, j: int, rows: Float64Array) -> Float64Array:
    """Return true torques at rising stage positions, shape (n, samples)."""
    basis = latent_basis(rows)
    slid = np.asarray((basis @ table.sliding[i, j]) @ _spline(table.bins.node_m).T)
    if not table.run_in:
        return slid
    nodes_m = table.bins.node_m[: table.sticking.shape[-1]]
    inside = np.abs(STAGE_M - nodes_m[0]) <= np.abs(nodes_m[-1] - nodes_m[0])
    held = (basis @ table.sticking[i, j]) @ _spline(nodes_m)[inside].T
    way_m = np.abs(STAGE_M[inside] - nodes_m[0])
    slid[:, inside] = np.where(way_m < (basis @ table.loose[i, j])[:, None], held, slid[:, inside])
    return slid


def _spline(node_m: Float64Array) -> Float64Array:
    """Return the map from nodes to samples, shape (samples, nodes)."""
    order = slice(None) if node_m[-1] > node_m[0] else slice(None, None, -1)
    return np.asarray(scipy.interpolate.CubicSpline(node_m[order], np.eye(len(node_m))[order])(STAGE_M))


@functools.lru_cache(maxsize=4)
def _cycles(gel: Gel, forward: bool, run_in: bool, excess: float) -> Float64Array:
    count = round((TO_M - FROM_M) / 0.001) + 1
    node_m = np.linspace(FROM_M, TO_M, count)
    return stick_slip_at(gel, node_m if forward else node_m[::-1], STAGE_M, excess, run_in=run_in)
