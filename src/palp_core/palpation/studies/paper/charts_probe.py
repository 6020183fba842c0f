"""The paper's figures of the probe: 7b (joint stiffness), 8 (sweeps at 8 mm), 9 (memory primitives)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.reporting.charts import Chart, depth_style, legend, ring_colours, tidy
from palp_core.palpation.studies.simulation.conditions import Conditions
from palp_core.palpation.studies.simulation.gel import (
    FROM_M,
    RATE_HZ,
    SPEED_M_PER_S,
    TO_M,
    Gel,
    add_noise,
    sweep_torque,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figure_7b(gel: Gel) -> Chart:
    """Joint stiffness over the joint's angle, eq. (6)."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 91)
    probe = Probe()
    curves = [1e3 * probe.joint_stiffness(ring_m, angle) for ring_m in gel.rings_m]
    rows = [[float(np.degrees(a)), *(float(c[i]) for c in curves)] for i, a in enumerate(angle)]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for ring_m, curve, colour in zip(gel.rings_m, curves, ring_colours(len(curves)), strict=True):
            axes.plot(np.degrees(angle), curve, color=colour, label=f"r_a = {ring_m * 1e3:g} mm")
        legend(axes)
        tidy(axes, "K_s = 2 r_a R k_s cos q", "joint angle q, degrees", "stiffness, N mm/rad")

    return Chart(
        "figure_07b_stiffness",
        "Figure 7(b): joint stiffness",
        "Eq. (6) with the published R = 6.8 mm and k_s = 0.24 N/mm: the same curves as the paper's.",
        3.4,
        ["angle_deg", *(f"n_mm_per_rad_at_{r * 1e3:g}_mm" for r in gel.rings_m)],
        rows,
        draw,
    )


def figure_8(gel: Gel, conditions: Conditions, seed: int, count: int = 25) -> Chart:
    """Mean and spread of de-noised sweeps at 8 mm, per ring position."""
    rng = np.random.default_rng(seed)
    stage_mm = 1e3 * np.arange(FROM_M, TO_M, SPEED_M_PER_S / RATE_HZ)
    inside = slice(edge_cone(), len(stage_mm) - edge_cone())
    step = 20
    bands = []
    for ring_m in gel.rings_m:
        landed_m = ring_m + conditions.landings_m(rng, (count,))
        true = [sweep_torque(gel, gel.depths_m[-1], at_m) for at_m in landed_m.tolist()]
        found = 1e3 * np.array([denoise(add_noise(one, gel, rng)) for one in true])
        bands.append((found.mean(axis=0), found.std(axis=0, ddof=1)))
    rows = [
        [float(stage_mm[i]), *(float(x[i]) for band in bands for x in band)]
        for i in range(inside.start, inside.stop, step)
    ]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for ring_m, (mean, sd), colour in zip(gel.rings_m, bands, ring_colours(len(bands)), strict=True):
            axes.fill_between(
                stage_mm[inside], (mean - sd)[inside], (mean + sd)[inside], color=colour, alpha=0.3
            )
            axes.plot(stage_mm[inside], mean[inside], color=colour, label=f"{ring_m * 1e3:g} mm")
            top = inside.start + int(np.argmax(mean[inside]))
            axes.plot(stage_mm[top], mean[top], "o", color=colour, markersize=4)
        legend(axes, "r_a")
        tidy(axes, f"d = 8 mm, {count} palpations each", "stage, mm", "torque, N mm")

    return Chart(
        "figure_08_sweeps",
        "Figure 8: de-noised torque at 8 mm",
        "Mean and standard deviation of the de-noised sweeps (db10, 5 levels), peaks marked. The spread is "
        "that of the ring's landing and of the sensor; the paper's gel and tip are not known, so its "
        "torques are not expected to be ours, their order over r_a is.",
        3.8,
        ["stage_mm", *(f"{k}_at_{r * 1e3:g}_mm_n_mm" for r in gel.rings_m for k in ("mean", "sd"))],
        rows,
        draw,
    )


def figure_9(primitives: Primitives) -> Chart:
    """Memory primitives: a normal per depth and ring position."""
    depths_m, rings_m = primitives.depths_m, primitives.rings_m
    rows = [
        [float(d) * 1e3, float(r) * 1e3, 1e3 * float(primitives.mean[i, k]), 1e3 * float(primitives.sd[i, k])]
        for i, d in enumerate(depths_m)
        for k, r in enumerate(rings_m)
    ]

    def draw(figure: Figure) -> None:
        panels = figure.subplots(1, len(rings_m))
        for k, axes in enumerate(panels):
            mean, sd = 1e3 * primitives.mean[:, k], 1e3 * primitives.sd[:, k]
            torque = np.linspace((mean - 4 * sd).min(), (mean + 4 * sd).max(), 300)
            for i in range(len(depths_m)):
                density = np.exp(-0.5 * ((torque - mean[i]) / sd[i]) ** 2) / (sd[i] * np.sqrt(2 * np.pi))
                look = {name: v for name, v in depth_style(i).items() if name != "marker"}
                axes.plot(torque, density, label=f"{depths_m[i] * 1e3:g} mm", **look)
            tidy(axes, f"r_a {rings_m[k] * 1e3:g} mm", "N mm", "density" if k == 0 else "")
        legend(figure, "depth", handles=panels[0].get_lines(), ncols=len(depths_m))

    return Chart(
        "figure_09_primitives",
        "Figure 9: memory primitives",
        "Normals fitted to 25 training peaks a cell in one session. At r_a = 0 the depths are one; the "
        "stiffer the joint, the further apart they are, as in the paper.",
        3.0,
        ["depth_mm", "ring_mm", "mean_n_mm", "sd_n_mm"],
        rows,
        draw,
    )
