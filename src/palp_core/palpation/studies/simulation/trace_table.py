"""What the probe feels along a sweep, tabulated: the trace in bins of the stage position over the latents.

A study takes hundreds of thousands of sweeps. Each is two curves, of a tip that slides and of one that still
sticks where it was lowered, and the place at which it breaks loose. All three are polynomials in the latents
that a world moves, with every cross term, fitted to solved sweeps spread over what the latents may be. A
test holds the table against whole sweeps.
"""

from __future__ import annotations

import functools
import itertools
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.errors import OutOfRange
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.studies.simulation.gel import FROM_M, RATE_HZ, SPEED_M_PER_S, TO_M, Gel
from palp_core.palpation.world.drag import drag, joints_of
from palp_core.palpation.world.latents import LATENTS, LOWEST, REACH, latents
from palp_core.palpation.world.model import WorldModel
from palp_core.palpation.world.slopes import Bins, bin_edges_m, bins_of
from palp_core.palpation.world.stick_slip import stick_slip
from palp_core.palpation.world.texture import bias, texture, texture_map, white_sd_n_m
from palp_core.palpation.world.touch import Touch, touch
from palp_core.units import Float64Array

_RUN_IN_M = 0.034  # a tip slides before the stage has gone so far, whatever the latents
_SAMPLES = 320
_SPREAD = 0.5  # of the reach: latents are rarely at its ends, where the polynomials may be worse
_CHUNK = 20_000
PHASES = 16
"""Shares of a cycle at which a sweep's stick-slip may begin."""
_CYCLE_M = 0.05e-3  # a cycle of stick-slip is about a millimetre of the stage's way


@dataclass(frozen=True)
class LatentBasis:
    """Products of scaled latents, which a table is linear in.

    Attributes:
        active: Indices of the latents that move; the others are nominal.
        reach: How far each of these may go; beyond it counts as that.
        degree: Of the products.
    """

    active: tuple[int, ...]
    reach: tuple[float, ...]
    degree: int

    @functools.cached_property
    def terms(self) -> tuple[tuple[int, ...], ...]:
        """Factors of each product, by place in ``active``."""
        places = range(len(self.active))
        return tuple(
            powers
            for degree in range(self.degree + 1)
            for powers in itertools.combinations_with_replacement(places, degree)
        )

    def products(self, rows: Float64Array) -> Float64Array:
        """Return every product for rows of latents of shape (n, 7), shape (n, terms)."""
        active, reach = list(self.active), np.array(self.reach)
        share = np.clip(rows[:, active], np.where(LOWEST[active] < 0.0, -reach, 0.0), reach) / reach
        made = np.empty((len(self.terms), len(rows)))
        made[0] = 1.0
        place = {powers: k for k, powers in enumerate(self.terms)}
        for k, powers in enumerate(self.terms[1:], start=1):
            np.multiply(made[place[powers[:-1]]], share[:, powers[-1]], out=made[k])
        return made.T

    def design(self) -> Float64Array:
        """Return rows of latents spread over their reach, shape (samples, 7)."""
        rows = np.zeros((_SAMPLES, len(LATENTS)))
        if len(self.active) == len(LATENTS):  # denser in the middle of the reach
            sobol = scipy.stats.qmc.Sobol(len(LATENTS), scramble=True, rng=np.random.default_rng(7))
            ends, even = 1.0 / _SPREAD, sobol.random(512)[:_SAMPLES]
            share = scipy.stats.truncnorm.ppf(even, -ends, ends, scale=_SPREAD)
            return np.asarray(np.where(LOWEST < 0.0, share, np.abs(share)) * self.reach)
        nodes = np.cos(np.pi * (np.arange(self.degree + 2) + 0.5) / (self.degree + 2))
        grid = np.stack([x.ravel() for x in np.meshgrid(*[nodes] * len(self.active))], axis=-1)
        rows = rows[: len(grid)]
        rows[:, list(self.active)] = grid * self.reach
        return rows


EVERY_LATENT = LatentBasis(tuple(range(len(LATENTS))), tuple(REACH.tolist()), 3)


def ring_and_height(height_reach_m: float) -> LatentBasis:
    """Return the basis of a world in which landing and height alone move."""
    return LatentBasis((0, 1), (float(REACH[0]), height_reach_m), 5)


@dataclass(frozen=True, eq=False)
class TraceTable:
    """Binned traces of every cell of depth class and ring as functions of the latents.

    Attributes:
        gel: What it was made from.
        basis: Latents that it answers to.
        pressed_m: Nominal indentation of the sweeps.
        bins: Bins of the stage position, rising, whichever way it is swept.
        forward: Whether the stage goes towards +Y; torques of a sweep back are negative.
        run_in: Whether a sweep begins upright, with a tip that sticks.
        rungs: Contact model per class.
        sliding: Coefficients at the nodes, shape (m, k, terms, p).
        sticking: Those of a tip that sticks, at the first nodes, shape (m, k, terms, q).
        loose: Those of the stage's way until the tip breaks loose, shape (m, k, terms).
        tip_m: Place of the ball at the nodes of the nominal sweep, shape (m, k, p).
        normal_n: Its normal force, shape (m, k, p).
    """

    gel: Gel
    basis: LatentBasis
    pressed_m: float
    bins: Bins
    forward: bool
    run_in: bool
    rungs: tuple[str, ...]
    sliding: Float64Array
    sticking: Float64Array
    loose: Float64Array
    tip_m: Float64Array
    normal_n: Float64Array

    def traces(self, depth: NDArray[np.int64], ring: NDArray[np.int64], rows: Float64Array) -> Float64Array:
        """Return the mean true torque in each bin, N m, shape (n, K).

        Args:
            depth: Class, shape (n,).
            ring: Index of the ring position, shape (n,).
            rows: Latents, shape (n, 7).
        """
        made = np.empty((len(depth), len(self.bins.mean)))
        cell = depth * len(self.gel.rings_m) + ring
        for number in np.unique(cell):
            (here,) = np.nonzero(cell == number)
            i, j = divmod(int(number), len(self.gel.rings_m))
            for start in range(0, len(here), _CHUNK):
                some = here[start : start + _CHUNK]
                made[some] = self._cell(i, j, rows[some])
        return made

    def texture(
        self, world: WorldModel, depth: NDArray[np.int64], ring: NDArray[np.int64], luck: Float64Array
    ) -> Float64Array:
        """Return what the surface adds to each bin, N m, shape (n, K).

        The surface is met where the ball is on the nominal sweep of the cell.

        Args:
            world: What the surface is like.
            depth: Class, shape (n,).
            ring: Index of the ring position, shape (n,).
            luck: Tracks of the mountings, of :func:`.track`, shape (n, 2, places).
        """
        made = np.zeros((len(depth), len(self.bins.mean)))
        if world.texture_sd_n_m == 0.0:
            return made
        cell = depth * len(self.gel.rings_m) + ring
        for number in np.unique(cell):
            (here,) = np.nonzero(cell == number)
            i, j = divmod(int(number), len(self.gel.rings_m))
            to_bins = self.bins.mean @ texture_map(world, self.bins.spline @ self.tip_m[i, j])
            for start in range(0, len(here), _CHUNK):
                some = here[start : start + _CHUNK]
                made[some] = texture(world, luck[some], to_bins, forward=self.forward)
        return made

    def stick_slip(
        self,
        world: WorldModel,
        depth: NDArray[np.int64],
        ring: NDArray[np.int64],
        phase: Float64Array,
        speed_m_per_s: float = SPEED_M_PER_S,
    ) -> Float64Array:
        """Return what stick-slip adds to each bin of the nominal sweep, N m, shape (n, K); 0 where none is.

        Args:
            world: Its static friction.
            depth: Class, shape (n,).
            ring: Index of the ring position, shape (n,).
            phase: Share of a cycle at the start, from 0 to 1, shape (n,).
            speed_m_per_s: Of the stage.
        """
        edges_m, excess = tuple(self.bins.edges_m.tolist()), world.static_friction_excess
        known = _cycles(self.gel, self.pressed_m, self.forward, self.run_in, edges_m, excess, speed_m_per_s)
        return np.asarray(known[depth, ring, np.rint(phase * PHASES).astype(np.int64) % PHASES])

    def sensor(
        self,
        world: WorldModel,
        luck: Float64Array,
        *,
        since_tare_s: float | Float64Array = 0.0,
        noise_sd_n_m: float = RESOLUTION_N_M,
        speed_m_per_s: float = SPEED_M_PER_S,
    ) -> Float64Array:
        """Return what the sensor adds to each bin: its zero, noise and rounding, N m, shape (n, K).

        Args:
            world: How the zero walks.
            luck: Standard normals, shape (n, 2 K + 2).
            since_tare_s: Seconds from the last tare to the start of each sweep.
            noise_sd_n_m: Of a sample.
            speed_m_per_s: Of the stage: a faster one leaves fewer samples a bin.
        """
        bins, bin_s = len(self.bins.mean), self.bin_m / speed_m_per_s
        white = white_sd_n_m(noise_sd_n_m, RESOLUTION_N_M, round(bin_s * RATE_HZ)) * luck[:, bins + 2 :]
        if world.tare_sd_n_m == world.bias_walk_n_m_per_sqrt_s == 0.0:
            return white
        zero = bias(world, luck[:, : bins + 2], bin_s, since_tare_s)
        return (zero if self.forward else zero[:, ::-1]) + white

    @property
    def bin_m(self) -> float:
        """Width of a bin."""
        return float(self.bins.edges_m[1] - self.bins.edges_m[0])

    def _cell(self, i: int, j: int, rows: Float64Array) -> Float64Array:
        basis = self.basis.products(rows)
        parts = self._parts
        made = np.asarray(basis @ (self.sliding[i, j] @ parts.to_bins.T))
        if self.run_in:
            slid = basis @ (self.sliding[i, j] @ parts.slid.T)
            held = basis @ (self.sticking[i, j] @ parts.held.T)
            felt = np.where(parts.way_m < (basis @ self.loose[i, j])[:, None], held, slid)
            made[:, parts.first] = felt @ parts.mean.T
        return made

    @functools.cached_property
    def _parts(self) -> _Parts:
        return _parts(self.bins, self.sticking.shape[-1])


@dataclass(frozen=True, eq=False)
class _Parts:
    """Linear maps of a table, in the order of the sweep: to all bins, and to the run-in's fine positions."""

    to_bins: Float64Array
    slid: Float64Array
    held: Float64Array
    mean: Float64Array
    way_m: Float64Array
    first: NDArray[np.int64]


def _parts(bins: Bins, held_nodes: int) -> _Parts:
    forward = bins.node_m[-1] > bins.node_m[0]
    end_m = bins.node_m[held_nodes - 1]
    inside = bins.edges_m[1:] <= end_m + 1e-12 if forward else bins.edges_m[:-1] >= end_m - 1e-12
    (first,) = np.nonzero(inside)
    fine = np.abs(bins.mean[first]).sum(axis=0) > 0.0
    order = slice(None) if forward else slice(None, None, -1)
    fine_m = bins.fine_m[fine][order]
    nodes_m = bins.node_m[:held_nodes]
    rising = slice(None) if forward else slice(None, None, -1)
    spline = scipy.interpolate.CubicSpline(nodes_m[rising], np.eye(held_nodes)[rising])
    return _Parts(
        bins.mean @ bins.spline,
        bins.spline[fine][order],
        np.asarray(spline(fine_m)),
        bins.mean[first][:, fine][:, order],
        np.abs(fine_m - bins.node_m[0]),
        first,
    )


def tabulate_traces(
    gel: Gel,
    *,
    basis: LatentBasis = EVERY_LATENT,
    forward: bool = True,
    run_in: bool = True,
    width_m: float = 0.002,
    path_m: tuple[float, float] = (FROM_M, TO_M),
    indentation_m: float | None = None,
) -> TraceTable:
    """Solve sweeps of every cell all over the latents' reach and fit the polynomials.

    Args:
        gel: What is touched; its contact is chosen by its reading.
        basis: Latents that move.
        forward: Whether the stage goes towards +Y.
        run_in: Whether a sweep begins upright, with a tip that sticks.
        width_m: Of a bin.
        path_m: Ends of the path, the lower first.
        indentation_m: Nominal indentation of these sweeps; None: the gel's, by which the contact is chosen.
    """
    if not 0.5e-3 <= width_m <= 0.02:
        raise OutOfRange("width_m", f"bins of {width_m:g} m; use 0.5 mm to 20 mm")
    pressed_m = gel.indentation_m if indentation_m is None else indentation_m
    return _tabulated(gel, basis, pressed_m, forward, run_in, width_m, path_m)


@functools.lru_cache(maxsize=32)
def _tabulated(
    gel: Gel,
    basis: LatentBasis,
    pressed_m: float,
    forward: bool,
    run_in: bool,
    width_m: float,
    path_m: tuple[float, float],
) -> TraceTable:
    bins = bins_of(bin_edges_m(*path_m, width_m), forward=forward)
    rows = basis.design()
    solver = np.linalg.pinv(basis.products(rows))
    terms = len(basis.terms)
    nodes, held_nodes = (
        len(bins.node_m),
        int(np.searchsorted(np.abs(bins.node_m - bins.node_m[0]), _RUN_IN_M, side="right")),
    )
    k, count = len(gel.rings_m), len(rows) + 1
    shape = (len(gel.depths_m), k)
    sliding, sticking = np.empty((*shape, terms, nodes)), np.empty((*shape, terms, held_nodes))
    loose = np.empty((*shape, terms))
    tip_m, normal_n = np.empty((*shape, nodes)), np.empty((*shape, nodes))
    every = np.concatenate([np.zeros((1, len(LATENTS))), rows])
    rungs = []
    for i, depth_m in enumerate(gel.depths_m):
        felt = _touch(gel, depth_m, tips=basis is EVERY_LATENT)
        rungs.append(felt.models[0].rung)
        for j, ring_m in enumerate(gel.rings_m):
            found = drag(felt, every, np.full(count, ring_m), pressed_m, bins.node_m, run_in=run_in)
            sliding[i, j] = solver @ found.sliding_n_m[1:]
            loose[i, j] = solver @ found.loose_m[1:]
            sticking[i, j] = solver @ found.sticking_n_m[1:, :held_nodes]
            tip_m[i, j], normal_n[i, j] = found.tip_m[0], found.normal_n[0]
    return TraceTable(
        gel, basis, pressed_m, bins, forward, run_in, tuple(rungs), sliding, sticking, loose, tip_m, normal_n
    )


@functools.lru_cache(maxsize=64)
def _cycles(
    gel: Gel,
    pressed_m: float,
    forward: bool,
    run_in: bool,
    edges_m: tuple[float, ...],
    excess: float,
    speed_m_per_s: float,
) -> Float64Array:
    """Return what stick-slip adds to each bin by depth, ring and phase, shape (m, k, phases, K)."""
    bins = bins_of(np.array(edges_m), forward=forward)
    width_m = edges_m[1] - edges_m[0]
    parts = round(width_m / _CYCLE_M)
    fine_m = bins.edges_m[0] + width_m * (np.arange(len(bins.mean) * parts) + 0.5) / parts
    whole = _stick_slip(
        gel, pressed_m, bins.node_m, fine_m, excess, run_in=run_in, speed_m_per_s=speed_m_per_s
    )
    return np.asarray(whole.reshape(*whole.shape[:3], -1, parts).mean(axis=-1))


def _stick_slip(
    gel: Gel,
    pressed_m: float,
    node_m: Float64Array,
    stage_m: Float64Array,
    excess: float,
    *,
    run_in: bool,
    speed_m_per_s: float = SPEED_M_PER_S,
) -> Float64Array:
    """Return what stick-slip adds to nominal sweeps, N m, shape (m, k, PHASES, f).

    Args:
        gel: What is touched.
        pressed_m: Nominal indentation.
        node_m: Positions that are solved for, in the order of the sweep.
        stage_m: Positions wanted, shape (f,).
        excess: Static friction over sliding friction, minus 1.
        run_in: Whether a sweep begins upright.
        speed_m_per_s: Of the stage.
    """
    k, direction = len(gel.rings_m), 1.0 if node_m[-1] > node_m[0] else -1.0
    made = np.zeros((len(gel.depths_m), k, PHASES, len(stage_m)))
    for i, depth_m in enumerate(gel.depths_m):
        felt = _touch(gel, depth_m, tips=False)
        rows, rings_m = latents(k), np.asarray(gel.rings_m)
        found = drag(felt, rows, rings_m, pressed_m, node_m, run_in=run_in)
        joints = joints_of(felt, rows, rings_m, pressed_m, direction)
        cycles = stick_slip(joints, found, excess, speed_m_per_s)
        for n in range(PHASES):
            made[i, :, n] = cycles.added(node_m, stage_m, speed_m_per_s, np.full(k, n / PHASES))
    return made


def _touch(gel: Gel, depth_m: float, *, tips: bool = True) -> Touch:
    scene = gel.scene(depth_m)
    return touch(scene.phantom, scene.probe, gel.chosen_rung(depth_m), tips=tips)
