"""Rungs L2 and L4 against linear elasticity in three dimensions: forces, and what the joint makes of them.

``python -m benchmarks.solids_3d.against`` prints how far they are off, by depth, from ``small_strain.csv``,
or from another file of :mod:`benchmarks.solids_3d.small_strain`.
"""

from __future__ import annotations

import csv
import itertools
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import RectBivariateSpline

from benchmarks.solids_3d.small_strain import TIP_M
from palp_core.palpation.mechanics import Bead, LayeredHertz, Phantom, Probe, Scene, StagePath, sweep
from palp_core.palpation.mechanics.contact.l4 import HarmonicContact
from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.scene.output import contrast_n_m, grid_m, peak_n_m
from palp_core.units import Float64Array

FILE = Path(__file__).parent / "small_strain.csv"
DEPTHS_M = (0.001, 0.002, 0.004, 0.008, 0.012)
LOADS = tuple(itertools.product((8e3, 20e3, 40e3), (0.002, 0.003, 0.004), (0.004, 0.008, 0.016)))
"""Young's modulus, indentation and ring."""
NEAR_M = 0.0121
"""Forces are compared up to this offset; farther out the elements are too coarse for the last per cent.

So they are on the axis, where the contact's edge meets a whole ring of nodes at once: the force there is held
against axisymmetric elements (``axisymmetric.py``).
"""


@dataclass(frozen=True)
class Row:
    """One contact that was solved, for Young's modulus 1."""

    depth_m: float
    facet_m: float
    offset_m: float
    indentation_m: float
    normal_m2: float
    lateral_m2: float
    energy_m3: float


def read(file: Path = FILE) -> list[Row]:
    """Return the contacts in a file."""
    lines = csv.DictReader(file.read_text(encoding="utf-8").splitlines())
    return [Row(**{name: float(value) for name, value in line.items()}) for line in lines]


def finest(rows: Sequence[Row], depth_m: float) -> dict[tuple[float, float], Row]:
    """Return the contacts at a depth by offset and indentation, each from the finest mesh that has it."""
    here = sorted((row for row in rows if row.depth_m == depth_m), key=lambda row: -row.facet_m)
    return {(row.offset_m, row.indentation_m): row for row in here}


class Solved:
    """A contact model made of the solved contacts, which the joint can be put on.

    Its energy is Hertz's times a smooth function of the offset and the root of the indentation, 1 at no
    indentation: what bare gel has over Hertz, on average over where the ball was pressed in, times what the
    bead adds at each place, as a ratio to bare gel on the same elements. Beyond the last place that falls off
    with the sixth power of the offset.
    """

    rung, reach_m, indentation_max_m = "3d", 0.05, 0.004

    def __init__(self, rows: Sequence[Row], depth_m: float, modulus_pa: float = 20e3) -> None:
        self.modulus_pa = modulus_pa
        offsets = np.array(sorted({row.offset_m for row in rows}))
        indented = np.array(sorted({row.indentation_m for row in rows}))
        with_bead, alone = (
            np.array([[found[s, z].energy_m3 for z in indented] for s in offsets])
            for found in (finest(rows, depth_m), finest(rows, 0.0))
        )
        bare = alone[offsets < NEAR_M].mean(axis=0) / self._hertz(indented)
        share = with_bead / alone
        far_m = np.array([0.045, 0.060, 0.080])
        share = np.concatenate([share, 1.0 + (share[-1] - 1.0) * (offsets[-1] / far_m[:, None]) ** 6])
        value = np.concatenate([np.ones((len(share), 1)), share * bare], axis=1)
        places = np.concatenate([offsets, far_m])
        mirrored = np.concatenate([-places[:0:-1], places]), np.concatenate([value[:0:-1], value])
        self._spline = RectBivariateSpline(mirrored[0], np.sqrt([0.0, *indented]), mirrored[1])

    @staticmethod
    def _hertz(indentation_m: Float64Array) -> Float64Array:
        return np.asarray(8.0 / 15.0 * np.sqrt(TIP_M) / (1.0 - 0.49**2) * indentation_m**2.5)

    def energy(self, offset_m: Float64Array, indentation_m: Float64Array) -> Float64Array:
        """Return U in J."""
        z = np.maximum(indentation_m, 0.0)
        return np.asarray(self.modulus_pa * self._hertz(z) * self._spline(offset_m, np.sqrt(z), grid=False))

    def force(self, offset_m: Float64Array, indentation_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return (normal_n, lateral_n)."""
        z = np.maximum(indentation_m, 1e-12)
        value, by_root = (self._spline(offset_m, np.sqrt(z), dy=n, grid=False) for n in (0, 1))
        scale = self.modulus_pa * self._hertz(z)
        normal = scale * (2.5 * value / z + 0.5 * by_root / np.sqrt(z))
        lateral = scale * self._spline(offset_m, np.sqrt(z), dx=1, grid=False)
        touching = np.asarray(indentation_m) > 0.0
        return np.where(touching, normal, 0.0), np.where(touching, lateral, 0.0)


def phantom_at(depth_m: float, modulus_pa: float = 20e3) -> Phantom:
    """Return the published phantom with its bead at a depth, bare at depth 0."""
    return Phantom(bead=Bead(depth_m=depth_m) if depth_m else None, modulus_pa=modulus_pa)


def rungs_at(depth_m: float, modulus_pa: float = 20e3) -> dict[str, ContactModel]:
    """Return the rungs that know such a phantom."""
    phantom = phantom_at(depth_m, modulus_pa)
    rungs: dict[str, ContactModel] = {"l4": HarmonicContact(phantom, TIP_M)}
    return rungs if depth_m == 0.001 else rungs | {"l2": LayeredHertz(phantom, TIP_M)}


def force_errors(
    rows: Sequence[Row], depth_m: float, rung: ContactModel, indentation_m: float
) -> tuple[float, float]:
    """Return the largest relative error of N beside the axis, and of U_s over the largest N."""
    normal, lateral = [], []
    here = [row for row in finest(rows, depth_m).values() if row.indentation_m == indentation_m]
    largest = max(row.normal_m2 for row in here)
    for row in here:
        if 0.0 < row.offset_m < NEAR_M:
            found = rung.force(np.array(row.offset_m), np.array(indentation_m))
            normal_m2, lateral_m2 = (float(force) / 20e3 for force in found)
            normal.append(normal_m2 / row.normal_m2 - 1.0)
            lateral.append((lateral_m2 - row.lateral_m2) / largest)
    return max(normal, key=abs), max(lateral, key=abs)


def scene_at(depth_m: float, modulus_pa: float, indentation_m: float, ring_m: float) -> Scene:
    """Return the published scene with one ring."""
    path = StagePath(indentation_m=indentation_m)
    return Scene(phantom=phantom_at(depth_m, modulus_pa), path=path, ring_m=(ring_m,))


def outputs(model: ContactModel, scene: Scene) -> tuple[float, float, float]:
    """Return peak and contrast of a sweep, and how deep the tip is at the peak."""
    stage_m = grid_m(scene, 0.0005)
    solved = sweep(model, Probe(), scene.ring_m[0], scene.path.indentation_m, stage_m)
    at_peak = float(solved.indentation_m[np.argmax(solved.torque_n_m)])
    return peak_n_m(solved), contrast_n_m(solved), at_peak


def output_errors(
    rows: Sequence[Row], depth_m: float, loads: Sequence[tuple[float, float, float]] = LOADS
) -> Iterator[tuple[Scene, str, float, float]]:
    """Give the relative errors of peak and contrast: (scene, rung, of the peak, of the contrast).

    Left out are sweeps whose tip is less deep at the peak than the shallowest contact that was solved.
    """
    truth = Solved(rows, depth_m)
    for modulus_pa, indentation_m, ring_m in loads:
        scene = scene_at(depth_m, modulus_pa, indentation_m, ring_m)
        truth.modulus_pa = modulus_pa
        true_peak, true_contrast, at_peak_m = outputs(truth, scene)
        if at_peak_m >= min(row.indentation_m for row in rows):
            for name, rung in rungs_at(depth_m, modulus_pa).items():
                peak, contrast, _ = outputs(rung, scene)
                yield scene, name, peak / true_peak - 1.0, contrast / true_contrast - 1.0


def _print(line: str) -> None:
    sys.stdout.write(line + "\n")


def main(file: Path = FILE) -> None:
    """Print the table."""
    rows = read(file)
    pressed = (0.001, 0.002, 0.003, 0.004)
    _print(
        "| d | model | N at 1; 2; 3; 4 mm | U_s over N there | peak | contrast |\n|---|---|---|---|---|---|"
    )
    for depth_m in DEPTHS_M:
        errors = list(output_errors(rows, depth_m))
        for name, rung in rungs_at(depth_m).items():
            normal, lateral = zip(*(force_errors(rows, depth_m, rung, at) for at in pressed), strict=True)
            peak = max((one[2] for one in errors if one[1] == name), key=abs)
            contrast = max((one[3] for one in errors if one[1] == name), key=abs)
            words = ["; ".join(f"{value:+.2%}" for value in values) for values in (normal, lateral)]
            words += [f"{peak:+.2%}", f"{contrast:+.2%}"]
            _print(f"| {depth_m * 1e3:g} mm | {name.upper()} | {' | '.join(words)} |")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
