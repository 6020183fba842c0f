"""Where each method is safe on the user's own axes: depth of the bead, ring, modulus, indentation."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom, Probe, sweep
from palp_core.palpation.mechanics.equilibrium.finders import (
    brent,
    continued_newton,
    fixed_point,
    plain_newton,
)
from palp_core.palpation.mechanics.equilibrium.joint import Joint
from palp_core.palpation.mechanics.scene.guard import SMALL_STRAIN_SHARE
from palp_core.palpation.reporting.charts import PALE_GREEN, PALE_VERMILION, Chart
from palp_core.units import Float64Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STAGE_M = np.linspace(-0.03, 0.05, 41)
_TIP_M = 0.006
_OFF_RAD = 1e-3
_CELL_M = 0.001

METHODS = {
    "plain_newton": "Newton from q = 0",
    "fixed_point": "fixed point, force of the last sample",
    "one_root": "one root per position, each for itself",
    "lagging_start": "a lagging equilibrium exists everywhere",
    "smooth_torque": "torque as a smooth function of the stage (no snap)",
    "small_strain": f"small strain: pressed less than {SMALL_STRAIN_SHARE:g} of the gel over the bead",
    "cells_1_mm": "cells of 1 mm: at most half the gel over the bead",
}


@dataclass(frozen=True)
class Point:
    """A scene on the user's axes, SI."""

    depth_m: float
    ring_m: float
    modulus_pa: float
    indentation_m: float


@dataclass(frozen=True)
class MapVerdict:
    """Whether each method of :data:`METHODS` is safe at a point."""

    point: Point
    safe: dict[str, bool]


def points(*, quick: bool) -> Iterator[Point]:
    """Return the grid."""
    depths = (0.0015, 0.002, 0.004, 0.008) if quick else (0.0015, 0.002, 0.003, 0.004, 0.006, 0.008, 0.012)
    rings = (0.0, 0.004, 0.016) if quick else (0.0, 0.004, 0.008, 0.012, 0.016)
    moduli = (5e3, 20e3) if quick else (5e3, 10e3, 20e3, 30e3)
    presses = (0.002, 0.004) if quick else (0.001, 0.002, 0.003, 0.004, 0.005)
    for depth_m, ring_m, modulus_pa, indentation_m in itertools.product(depths, rings, moduli, presses):
        yield Point(depth_m, ring_m, modulus_pa, indentation_m)


def verdicts(*, quick: bool, progress: Callable[[], None] = lambda: None) -> list[MapVerdict]:
    """Return what is safe at each point of the grid."""
    found = []
    for point in points(quick=quick):
        found.append(judge(point))
        progress()
    return found


def judge(point: Point) -> MapVerdict:
    """Return what is safe at a point, each method run there."""
    model = LayeredHertz(Phantom(bead=Bead(depth_m=point.depth_m), modulus_pa=point.modulus_pa), _TIP_M)
    probe = Probe()
    joint = Joint(model, probe, point.ring_m, point.indentation_m)
    safe = {"cells_1_mm": point.depth_m >= 2.0 * _CELL_M}
    try:
        solved = sweep(model, probe, point.ring_m, point.indentation_m, _STAGE_M)
    except MechanicsError:
        return MapVerdict(point, safe | dict.fromkeys(set(METHODS) - set(safe), False))
    true = continued_newton(joint, _STAGE_M)

    def follows(finder: Callable[[Joint, Float64Array], Float64Array]) -> bool:
        return bool(np.all(np.abs(finder(joint, _STAGE_M) - true) < _OFF_RAD))

    over = np.abs(solved.offset_m) <= 0.0075
    return MapVerdict(
        point,
        safe
        | {
            "plain_newton": follows(plain_newton),
            "fixed_point": follows(fixed_point),
            "one_root": bool(solved.root_count.max() <= 1) or follows(brent),
            "lagging_start": True,
            "smooth_torque": not solved.snapped and bool(solved.root_count.max() <= 1),
            "small_strain": float(solved.indentation_m[over].max()) <= SMALL_STRAIN_SHARE * point.depth_m,
        },
    )


def map_chart(found: list[MapVerdict], method: str) -> Chart:
    """Return one method's map: a panel per modulus and indentation, depth against ring in each."""
    axis = {
        name: sorted({getattr(v.point, name) for v in found})
        for name in ("depth_m", "ring_m", "modulus_pa", "indentation_m")
    }
    safe = {v.point: v.safe[method] for v in found}
    moduli, presses = axis["modulus_pa"], axis["indentation_m"]

    def draw(figure: Figure) -> None:
        from matplotlib.colors import ListedColormap

        colours = ListedColormap([PALE_VERMILION, PALE_GREEN])  # not safe, safe; crosses say it too
        figure.suptitle(f"{METHODS[method]}\n× and orange: not safe", x=0.01, ha="left", fontweight="bold")
        panels = figure.subplots(len(moduli), len(presses), squeeze=False, sharex=True, sharey=True)
        for i, modulus_pa in enumerate(moduli):
            for j, indentation_m in enumerate(presses):
                axes = panels[i][j]
                grid = [
                    [safe[Point(d, r, modulus_pa, indentation_m)] for r in axis["ring_m"]]
                    for d in axis["depth_m"]
                ]
                axes.imshow(np.array(grid, dtype=float), cmap=colours, vmin=0, vmax=1, aspect="auto")
                for y, x in zip(*np.nonzero(~np.array(grid)), strict=True):
                    axes.text(x, y, "×", ha="center", va="center", fontsize=7)
                axes.set_xticks(range(len(axis["ring_m"])), [f"{r * 1e3:g}" for r in axis["ring_m"]])
                axes.set_yticks(range(len(axis["depth_m"])), [f"{d * 1e3:g}" for d in axis["depth_m"]])
                axes.grid(visible=False)
                if i == 0:
                    axes.set_title(f"pressed {indentation_m * 1e3:g} mm", loc="left")
                if j == 0:
                    axes.set_ylabel(f"{modulus_pa * 1e-3:g} kPa\nd, mm")
                if i == len(moduli) - 1:
                    axes.set_xlabel("r_a, mm")

    share = float(np.mean(list(safe.values())))
    return Chart(
        f"map_{method}",
        f"Safe or not: {METHODS[method]}",
        f"A panel per modulus (rows) and nominal indentation (columns); × and orange: not safe. "
        f"Safe in {100 * share:.0f} % of {len(safe)} scenes. Contact: L2, bead of 7.5 mm, ball of 6 mm, "
        f"mu = 0.3.",
        1.6 + 1.5 * len(moduli),
        ("depth_m", "ring_m", "modulus_pa", "indentation_m", "safe"),
        [(p.depth_m, p.ring_m, p.modulus_pa, p.indentation_m, int(ok)) for p, ok in safe.items()],
        draw,
    )
