"""What a bead adds to the torque of a lane, by the mechanics, tabulated for a search.

A lane's base torque, over bare gel, shows one direction of what the rig is off by: height, modulus, friction
and the ring's landing all raise it. So answers are tabulated at levels along that direction, each with its
slopes there, and a search takes those of the level that it finds. Offsets are counted in their spreads.
"""

from __future__ import annotations

import hashlib
from dataclasses import astuple
from functools import cache
from pathlib import Path

import numpy as np

from palp_core.palpation.mechanics.contact.cache import Arrays, cached
from palp_core.palpation.mechanics.phantom import Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.world.drag import drag
from palp_core.palpation.world.latents import LATENTS
from palp_core.palpation.world.plane import PlaneContact, bare_table, bead_table
from palp_core.palpation.world.slopes import binned, bins_of
from palp_core.palpation.world.touch import Touch
from palp_core.units import Float64Array

OFFSETS = ("height_m", "modulus", "friction", "ring_m")
"""What the rig is off by, of the latents of a sweep."""
_COLUMNS = [LATENTS.index(name) for name in OFFSETS]


def lane_answers(
    ring_m: float,
    spreads: Float64Array,
    levels: Float64Array,
    beside_m: Float64Array,
    depths_m: Float64Array,
    past_m: Float64Array,
    *,
    probe: Probe,
    gel: Phantom,
    indentation_m: float,
) -> Arrays:
    """Return the answers of lanes at a ring, from the cache on disk if they have been computed before.

    Args:
        ring_m: Nominal position of the ring.
        spreads: Of :data:`OFFSETS`, SI, shape (4,).
        levels: Along the base's direction, in spreads, shape (t,).
        beside_m: Distances from the lane to the bead, shape (s,).
        depths_m: Depths of the bead, shape (d,).
        past_m: Middles of bins of the stage past the bead, evenly spaced, shape (u,).
        probe: The nominal probe.
        gel: The slab, without a bead.
        indentation_m: Nominal indentation.

    Returns:
        ``line`` (t, 4), offsets of each level in spreads; ``base_n_m`` (t,), ``base_slope`` (t, 4) and
        ``lag_m`` (t,), torque of bare gel, its slopes, and how far the ball is behind the stage; ``signal``
        (t, s, d, u), what the bead adds, and ``slope`` (t, s, d, u, 4), its slopes. Slopes are N m a spread.
    """
    numbers = (ring_m, spreads, levels, beside_m, depths_m, past_m, astuple(probe), indentation_m)
    slab = (gel.modulus_pa, gel.poisson, gel.height_m)
    text = hashlib.sha256(b"".join(np.asarray(one, dtype=np.float64).tobytes() for one in (*numbers, slab)))
    inputs = {"numbers": text.hexdigest(), "source": _source()}

    def compute() -> Arrays:
        return _compute(
            ring_m,
            spreads,
            levels,
            beside_m,
            depths_m,
            past_m,
            probe=probe,
            gel=gel,
            indentation_m=indentation_m,
        )

    return cached("lane-answers", inputs, compute)


@cache
def _source() -> str:
    """Return a digest of what answers follow from, next to the contact."""
    here = Path(__file__).parent
    names = ("answers", "plane", "drag", "slopes", "touch", "latents")
    paths = [here / f"{name}.py" for name in names]
    paths += sorted((here.parent / "mechanics" / "equilibrium").glob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()


def _compute(
    ring_m: float,
    spreads: Float64Array,
    levels: Float64Array,
    beside_m: Float64Array,
    depths_m: Float64Array,
    past_m: Float64Array,
    *,
    probe: Probe,
    gel: Phantom,
    indentation_m: float,
) -> Arrays:
    half_m = 0.5 * (past_m[1] - past_m[0])
    bins = bins_of(np.append(past_m - half_m, past_m[-1] + half_m))
    bare = bare_table(gel, probe.tip_radius_m)
    empty = Touch(probe, (PlaneContact(bare, (), gel.modulus_pa, 0.0),), 1.0)
    few_m = bins.node_m[:9]

    def rows_of(offsets: Float64Array) -> Float64Array:
        rows = np.zeros((len(offsets), len(LATENTS)))
        rows[:, _COLUMNS] = offsets * spreads
        return rows

    def base(offsets: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return torque and lag on bare gel, both (n,)."""
        rows = rows_of(offsets)
        found = drag(empty, rows, np.full(len(rows), ring_m), indentation_m, few_m, run_in=False)
        return found.torque_n_m[:, -1], few_m[-1] - found.tip_m[:, -1]

    steps = np.concatenate([np.zeros((1, 4)), np.eye(4), -np.eye(4)])
    around, _ = base(steps)
    uphill = around[1:5] - around[5:]
    line = levels[:, None] * uphill / np.linalg.norm(uphill)
    offsets = (line[:, None] + steps).reshape(-1, 4)
    bare_n_m, lag_m = (one.reshape(len(levels), -1) for one in base(offsets))
    felt = np.empty((len(levels), len(steps), len(beside_m), len(depths_m), len(past_m)))
    for k, depth_m in enumerate(depths_m):
        table = bead_table(float(depth_m), 0.0075, gel, probe.tip_radius_m)
        over = Touch(probe, (PlaneContact(bare, ((0.0, 0.0, table),), gel.modulus_pa, 0.0),), 1.0)
        rows = np.repeat(rows_of(offsets), len(beside_m), axis=0)
        rows[:, LATENTS.index("beside_m2")] = np.tile(np.square(beside_m), len(offsets))
        found = drag(over, rows, np.full(len(rows), ring_m), indentation_m, bins.node_m, run_in=False)
        felt[:, :, :, k] = binned(bins, found, run_in=False).reshape(*felt.shape[:3], -1)
    signal = felt - bare_n_m[:, :, None, None, None]
    return {
        "line": line,
        "base_n_m": bare_n_m[:, 0],
        "base_slope": 0.5 * (bare_n_m[:, 1:5] - bare_n_m[:, 5:]),
        "lag_m": lag_m[:, 0],
        "signal": signal[:, 0],
        "slope": np.moveaxis(0.5 * (signal[:, 1:5] - signal[:, 5:]), 1, -1),
    }
