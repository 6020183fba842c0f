"""Cases of the stability map: finite elements, the layers they stand on, and small strain."""

import numpy as np

from palp_core.palpation.mechanics import Phantom
from palp_core.palpation.mechanics.contact import fem_failures
from palp_core.palpation.studies.stability.case import Case
from palp_core.units import Float64Array

_SWEEP_S = 4.0


def fem_cases(*, quick: bool) -> list[Case]:
    """Return the cases, over few values if quick."""
    return [
        _locking(quick),
        _iterative(quick),
        _truncated(quick),
        _cells(quick),
        _explicit(quick),
        _small_strain(quick),
    ]


def _towards_half(count: int) -> Float64Array:
    return 0.5 - np.geomspace(0.2, 1e-5, count)


def _locking(quick: bool) -> Case:
    ratios = _towards_half(6 if quick else 16)
    return Case(
        "linear_triangles",
        "linear triangles (P1), five cells under the load",
        "Taylor-Hood on the same mesh",
        "Poisson's ratio",
        ratios,
        "relative error of the sinking under a disc",
        np.array([abs(fem_failures.softness_error_of_linear_triangles(float(nu))) for nu in ratios]),
        np.array([abs(fem_failures.softness_error_of_taylor_hood(float(nu))) for nu in ratios]),
        0.1,
        "A linear triangle that keeps its area cannot bend: it locks as the gel becomes incompressible.",
        axis="to_half",
        rig=(Phantom().poisson,),
    )


def _iterative(quick: bool) -> Case:
    ratios = _towards_half(6 if quick else 12)
    counts = [fem_failures.iterations_of_conjugate_gradients(float(nu)) for nu in ratios]

    def one_solution(poisson: float) -> float:
        return 1.0 if fem_failures.residual_of_direct_solution(poisson) < 1e-8 else np.inf

    return Case(
        "iterative_solver",
        "conjugate gradients, diagonal preconditioner",
        "sparse direct solution",
        "Poisson's ratio",
        ratios,
        "iterations to 1e-8",
        np.array([np.inf if count is None else float(count) for count in counts]),
        np.array([one_solution(float(nu)) for nu in ratios]),
        3000.0,
        "The condition of the matrix grows as 1 / (1 - 2 nu).",
        axis="to_half",
        rig=(Phantom().poisson,),
    )


def _truncated(quick: bool) -> Case:
    radii = np.array([0.03, 0.06, 0.12, 0.2]) if quick else np.geomspace(0.025, 0.25, 14)
    endless = fem_failures.softness_error_of_taylor_hood(0.49, 6, 0.3)  # of the widest block
    return Case(
        "truncated_block",
        "a block of gel held at its outer edge, nu = 0.49",
        "the endless layer in closed form (Hankel transform)",
        "radius of the block, mm",
        radii * 1e3,
        "relative error of the sinking under a disc",
        np.array([abs(fem_failures.truncation_error(float(r))) for r in radii]),
        np.full(len(radii), abs(1.0 / (1.0 + endless) - 1.0)),
        1e-3,
        "The edge holds back what an endless slab would let go, and so lifts every force alike.",
        axis="log",
    )


def _cells(quick: bool) -> Case:
    shares = np.array([0.25, 1.1]) if quick else np.array([0.25, 0.5, 0.7, 1.0, 1.4, 2.0])

    def error(share: float, averaged: bool) -> float:
        lowest, off = fem_failures.coarse_cells(share, averaged)
        return abs(off) if lowest > 0.0 and np.isfinite(off) else np.inf

    return Case(
        "coarse_cells",
        "the bead's stiffening taken at the centre of each cell (L4)",
        "averaged over each cell; cells of at most half the gel over the bead",
        "cell over the gel above the bead",
        shares,
        "relative error of the normal force on the axis",
        np.array([error(float(share), False) for share in shares]),
        np.array([error(float(share), True) for share in shares]),
        0.05,
        "Over thin gel the stiffening varies within a cell: the force is too high, and the compliance is no "
        "longer positive definite.",
        axis="log",
        rig=(0.125, 0.25, 0.5),  # cells of 1 mm over 8, 4 and 2 mm of gel
    )


def _explicit(quick: bool) -> Case:
    ratios = _towards_half(4 if quick else 10)
    step_s = np.array([fem_failures.critical_step_s(float(nu)) for nu in ratios])
    return Case(
        "explicit_elements",
        "explicit finite elements of 0.4 mm, E = 20 kPa",
        "condensed quasi-static compliance: one solution per stage position",
        "Poisson's ratio",
        ratios,
        "solutions per sweep of 4 s",
        _SWEEP_S / step_s,
        np.full(len(ratios), 161.0),
        1e4,
        "The step is limited by the pressure wave through the smallest element (Courant, Friedrichs, Lewy); "
        "one longer by a fiftieth lets it grow without end.",
        axis="to_half",
        rig=(Phantom().poisson,),
    )


def _small_strain(quick: bool) -> Case:
    pressed_m = np.linspace(0.0003, 0.006, 6 if quick else 39)
    return Case(
        "small_strain",
        "small strain (L4), ball of 6 mm on bare gel",
        "finite strain (L5), and beyond its elements an honest refusal",
        "indentation, mm",
        pressed_m * 1e3,
        "relative error of the normal force",
        np.abs(fem_failures.small_strain_excess(pressed_m)),
        np.abs(fem_failures.finite_strain_error(pressed_m)),
        0.05,
        "Strains that are not small are taken for small ones; over a bead L5 ends before it is as much.",
        rig=(4.0,),
    )
