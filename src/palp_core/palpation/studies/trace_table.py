"""Torques of sweeps, tabulated: the trace in bins of the stage position over the latents.

A study takes hundreds of thousands of sweeps. Each is two curves, of a tip that slides and of one that still
sticks where it was lowered, and the place at which it breaks loose. All three are polynomials in the latents
that a world moves, with every cross term, fitted to solved sweeps spread over what the latents may be. A
test holds the table against whole sweeps.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.studies.plan import PATH_M, RATE_HZ, SPEED_M_PER_S, Gel
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
_PHASES = 16  # shares of a cycle at which a sweep's stick-slip may begin
_CYCLE_M = 0.05e-3  # a cycle of stick-slip is about a millimetre of the stage's way


@dataclass(frozen=True)
class LatentBasis:
    """Products of scaled latents, which a table is linear in."""

    active: tuple[int, ...]  # indices of the latents that move; the others are nominal
    reach: tuple[float, ...]  # how far each of these may go; beyond it counts as that
    degree: int  # of the products

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
    """Binned traces of every cell of depth class and ring as functions of the latents."""

    gel: Gel  # what it was made from
    basis: LatentBasis  # latents that it answers to
    bins: Bins  # bins of the stage position, rising
    run_in: bool  # whether a sweep begins upright, with a tip that sticks
    rungs: tuple[str, ...]  # contact model per class
    sliding: Float64Array  # coefficients at the nodes, shape (m, k, terms, p)
    sticking: Float64Array  # those of a tip that sticks, at the first nodes, shape (m, k, terms, q)
    loose: Float64Array  # those of the stage's way until the tip breaks loose, shape (m, k, terms)
    tip_m: Float64Array  # place of the ball at the nodes of the nominal sweep, shape (m, k, p)

    def traces(self, depth: NDArray[np.int64], ring: NDArray[np.int64], rows: Float64Array) -> Float64Array:
        """Return the mean true torque in each bin, N m, shape (n, K)."""
        made = np.empty((len(depth), len(self.bins.mean)))
        for i, j, some in self._by_cell(depth, ring):
            made[some] = self._cell(i, j, rows[some])
        return made

    def texture(
        self, world: WorldModel, depth: NDArray[np.int64], ring: NDArray[np.int64], luck: Float64Array
    ) -> Float64Array:
        """Return what the surface adds to each bin, N m, shape (n, K).

        The surface is met where the ball is on the nominal sweep of the cell; ``luck`` are the tracks of the
        mountings, of :func:`track`, shape (n, 2, places).
        """
        made = np.zeros((len(depth), len(self.bins.mean)))
        if world.texture_sd_n_m == 0.0:
            return made
        for i, j, some in self._by_cell(depth, ring):
            to_bins = self.bins.mean @ texture_map(world, self.bins.spline @ self.tip_m[i, j])
            made[some] = texture(world, luck[some], to_bins, forward=True)
        return made

    def stick_slip(
        self, world: WorldModel, depth: NDArray[np.int64], ring: NDArray[np.int64], phase: Float64Array
    ) -> Float64Array:
        """Return what stick-slip adds to each bin of the nominal sweep, N m, shape (n, K); 0 where none is.

        ``phase`` is the share of a cycle at the start, from 0 to 1, shape (n,).
        """
        if world.static_friction_excess == 0.0:
            return np.zeros((len(depth), len(self.bins.mean)))
        edges_m = tuple(self.bins.edges_m.tolist())
        known = _cycles(self.gel, self.run_in, edges_m, world.static_friction_excess)
        return np.asarray(known[depth, ring, np.rint(phase * _PHASES).astype(np.int64) % _PHASES])

    def sensor(
        self,
        world: WorldModel,
        luck: Float64Array,
        *,
        since_tare_s: float | Float64Array = 0.0,
        noise_sd_n_m: float = RESOLUTION_N_M,
    ) -> Float64Array:
        """Return what the sensor adds to each bin: its zero, noise and rounding, N m, shape (n, K)."""
        bins, bin_s = len(self.bins.mean), self.bin_m / SPEED_M_PER_S
        white = white_sd_n_m(noise_sd_n_m, RESOLUTION_N_M, round(bin_s * RATE_HZ)) * luck[:, bins + 2 :]
        if world.tare_sd_n_m == world.bias_walk_n_m_per_sqrt_s == 0.0:
            return white
        return bias(world, luck[:, : bins + 2], bin_s, since_tare_s) + white

    @property
    def bin_m(self) -> float:
        """Width of a bin."""
        return float(self.bins.edges_m[1] - self.bins.edges_m[0])

    def _by_cell(
        self, depth: NDArray[np.int64], ring: NDArray[np.int64]
    ) -> Iterator[tuple[int, int, NDArray[np.intp]]]:
        """Yield class, ring and the rows of each cell, so many at a time."""
        cell = depth * len(self.gel.rings_m) + ring
        for number in np.unique(cell):
            (here,) = np.nonzero(cell == number)
            i, j = divmod(int(number), len(self.gel.rings_m))
            for start in range(0, len(here), _CHUNK):
                yield i, j, here[start : start + _CHUNK]

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
    """Linear maps of a table: to all bins, and to the run-in's fine positions."""

    to_bins: Float64Array
    slid: Float64Array
    held: Float64Array
    mean: Float64Array
    way_m: Float64Array
    first: NDArray[np.int64]


def _parts(bins: Bins, held_nodes: int) -> _Parts:
    (first,) = np.nonzero(bins.edges_m[1:] <= bins.node_m[held_nodes - 1] + 1e-12)
    fine = np.abs(bins.mean[first]).sum(axis=0) > 0.0
    fine_m = bins.fine_m[fine]
    spline = scipy.interpolate.CubicSpline(bins.node_m[:held_nodes], np.eye(held_nodes))
    return _Parts(
        bins.mean @ bins.spline,
        bins.spline[fine],
        np.asarray(spline(fine_m)),
        bins.mean[first][:, fine],
        np.abs(fine_m - bins.node_m[0]),
        first,
    )


@functools.lru_cache(maxsize=32)
def tabulate_traces(
    gel: Gel,
    *,
    basis: LatentBasis = EVERY_LATENT,
    run_in: bool = True,
    width_m: float = 0.002,
    path_m: tuple[float, float] = PATH_M,
) -> TraceTable:
    """Solve sweeps of every cell all over the latents' reach and fit the polynomials."""
    bins = bins_of(bin_edges_m(*path_m, width_m))
    rows = basis.design()
    solver = np.linalg.pinv(basis.products(rows))
    terms, nodes = len(basis.terms), len(bins.node_m)
    held_nodes = int(np.searchsorted(np.abs(bins.node_m - bins.node_m[0]), _RUN_IN_M, side="right"))
    k, count = len(gel.rings_m), len(rows) + 1
    shape = (len(gel.depths_m), k)
    sliding, sticking = np.empty((*shape, terms, nodes)), np.empty((*shape, terms, held_nodes))
    loose, tip_m = np.empty((*shape, terms)), np.empty((*shape, nodes))
    every = np.concatenate([np.zeros((1, len(LATENTS))), rows])
    rungs = []
    for i, depth_m in enumerate(gel.depths_m):
        felt = _touch(gel, depth_m, tips=basis is EVERY_LATENT)
        rungs.append(felt.models[0].rung)
        for j, ring_m in enumerate(gel.rings_m):
            found = drag(felt, every, np.full(count, ring_m), gel.indentation_m, bins.node_m, run_in=run_in)
            sliding[i, j] = solver @ found.sliding_n_m[1:]
            loose[i, j] = solver @ found.loose_m[1:]
            sticking[i, j] = solver @ found.sticking_n_m[1:, :held_nodes]
            tip_m[i, j] = found.tip_m[0]
    return TraceTable(gel, basis, bins, run_in, tuple(rungs), sliding, sticking, loose, tip_m)


@functools.lru_cache(maxsize=64)
def _cycles(gel: Gel, run_in: bool, edges_m: tuple[float, ...], excess: float) -> Float64Array:
    """Return what stick-slip adds to each bin of nominal sweeps, N m, shape (m, k, phases, K)."""
    bins = bins_of(np.array(edges_m))
    width_m = edges_m[1] - edges_m[0]
    parts = round(width_m / _CYCLE_M)
    fine_m = bins.edges_m[0] + width_m * (np.arange(len(bins.mean) * parts) + 0.5) / parts
    rings_m = np.asarray(gel.rings_m)
    rows = latents(len(rings_m))
    made = np.zeros((len(gel.depths_m), len(rings_m), _PHASES, len(fine_m)))
    for i, depth_m in enumerate(gel.depths_m):
        felt = _touch(gel, depth_m, tips=False)
        found = drag(felt, rows, rings_m, gel.indentation_m, bins.node_m, run_in=run_in)
        joints = joints_of(felt, rows, rings_m, gel.indentation_m, 1.0)
        cycles = stick_slip(joints, found, excess, SPEED_M_PER_S)
        for n in range(_PHASES):
            phase = np.full(len(rings_m), n / _PHASES)
            made[i, :, n] = cycles.added(bins.node_m, fine_m, SPEED_M_PER_S, phase)
    return np.asarray(made.reshape(*made.shape[:3], -1, parts).mean(axis=-1))


def _touch(gel: Gel, depth_m: float, *, tips: bool) -> Touch:
    scene = gel.scene(depth_m)
    return touch(scene.phantom, scene.probe, gel.chosen_rung(depth_m), tips=tips)
