"""The paper's figures of the rig, 7b to 12, and what it did not show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.reporting import charts
from palp_core.palpation.studies.paper.numbers import PUBLISHED
from palp_core.palpation.studies.plan import (
    FROM_M,
    RATE_HZ,
    SPEED_M_PER_S,
    TO_M,
    Conditions,
    Gel,
    add_noise,
    sweep_torque,
)
from palp_core.palpation.studies.trials import Outcomes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = 8  # iterations


def figure_7b(gel: Gel) -> charts.Chart:
    """Joint stiffness over the joint's angle, eq. (6)."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 91)
    probe = Probe()
    curves = [1e3 * probe.joint_stiffness(ring_m, angle) for ring_m in gel.rings_m]
    rows = [[float(np.degrees(a)), *(float(c[i]) for c in curves)] for i, a in enumerate(angle)]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for ring_m, curve, colour in zip(gel.rings_m, curves, charts.ring_colours(len(curves)), strict=True):
            axes.plot(np.degrees(angle), curve, color=colour, label=f"r_a = {ring_m * 1e3:g} mm")
        charts.legend(axes)
        charts.tidy(axes, "K_s = 2 r_a R k_s cos q", "joint angle q, degrees", "stiffness, N mm/rad")

    return charts.Chart(
        "figure_07b_stiffness",
        "Figure 7(b): joint stiffness",
        "Eq. (6) with the published R = 6.8 mm and k_s = 0.24 N/mm: the same curves as the paper's.",
        3.4,
        ["angle_deg", *(f"n_mm_per_rad_at_{r * 1e3:g}_mm" for r in gel.rings_m)],
        rows,
        draw,
    )


def figure_8(gel: Gel, conditions: Conditions, seed: int, count: int = 25) -> charts.Chart:
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
        for ring_m, (mean, sd), colour in zip(
            gel.rings_m, bands, charts.ring_colours(len(bands)), strict=True
        ):
            axes.fill_between(
                stage_mm[inside], (mean - sd)[inside], (mean + sd)[inside], color=colour, alpha=0.3
            )
            axes.plot(stage_mm[inside], mean[inside], color=colour, label=f"{ring_m * 1e3:g} mm")
            top = inside.start + int(np.argmax(mean[inside]))
            axes.plot(stage_mm[top], mean[top], "o", color=colour, markersize=4)
        charts.legend(axes, "r_a")
        charts.tidy(axes, f"d = 8 mm, {count} palpations each", "stage, mm", "torque, N mm")

    return charts.Chart(
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


def figure_9(primitives: Primitives) -> charts.Chart:
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
                look = {name: v for name, v in charts.depth_style(i).items() if name != "marker"}
                axes.plot(torque, density, label=f"{depths_m[i] * 1e3:g} mm", **look)
            charts.tidy(axes, f"r_a {rings_m[k] * 1e3:g} mm", "N mm", "density" if k == 0 else "")
        charts.legend(figure, "depth", handles=panels[0].get_lines(), ncols=len(depths_m))

    return charts.Chart(
        "figure_09_primitives",
        "Figure 9: memory primitives",
        "Normals fitted to 25 training peaks a cell in one session. At r_a = 0 the depths are one; the "
        "stiffer the joint, the further apart they are, as in the paper.",
        3.0,
        ["depth_mm", "ring_mm", "mean_n_mm", "sd_n_mm"],
        rows,
        draw,
    )


def figures_10_and_11(
    sessions: Mapping[str, Sequence[Outcomes]], depths_m: Sequence[float], took: Mapping[str, Any]
) -> list[charts.Chart]:
    """Belief over iterations of two fixed positions and of the human strategy."""
    ours = ", ".join(f"{one['value']:.2f} at {depth} mm" for depth, one in took["by_depth"].items())
    captions = {
        "fixed_16": "The paper reports no progress over iterations and shows an example. Ours: mean over "
        "sessions with its standard error. A trial that has stopped keeps its last belief.",
        "fixed_8": "As before at the middle position: the readings of a trial share one landing of the ring, "
        "so further probes hardly move the mean.",
        "markov": "The paper: most trials end within 5 iterations, more the deeper the nodule. Ours took "
        f"{ours} on average, with the reconstructed average matrix, read as draws from its columns.",
    }
    titles = {
        "fixed_16": "Figure 10: belief over iterations, fixed r_a = 16 mm",
        "fixed_8": "Figure 10: belief over iterations, fixed r_a = 8 mm",
        "markov": "Figure 11: belief over iterations, human strategy",
    }
    return [
        _beliefs(f"figure_{title[7:9]}_{name}", title, captions[name], sessions[name], depths_m)
        for name, title in titles.items()
    ]


def _beliefs(
    name: str, title: str, caption: str, sessions: Sequence[Outcomes], depths_m: Sequence[float]
) -> charts.Chart:
    """Posterior mean depth over iterations, with standard errors over sessions: Figures 10 and 11."""
    curves = []
    for c in range(len(depths_m)):
        means = np.array([1e3 * one.expected_m[one.depth == c, :SHOWN].mean(axis=0) for one in sessions])
        error = means.std(axis=0, ddof=1) / np.sqrt(len(means)) if len(means) > 1 else 0.0 * means[0]
        curves.append((means.mean(axis=0), error))
    rows = [
        [t + 1, f"{depth_m * 1e3:g}", float(mean[t]), float(error[t])]
        for depth_m, (mean, error) in zip(depths_m, curves, strict=True)
        for t in range(SHOWN)
    ]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for i, (depth_m, (mean, error)) in enumerate(zip(depths_m, curves, strict=True)):
            at = np.arange(1, SHOWN + 1)
            axes.errorbar(
                at, mean, error, **charts.depth_style(i), markersize=3.5, label=f"{depth_m * 1e3:g} mm"
            )
            axes.axhline(1e3 * depth_m, color=charts.depth_style(i)["color"], linewidth=0.6, linestyle=":")
        charts.legend(axes, "true depth")
        charts.tidy(axes, "", "iteration", "expected depth, mm")

    columns = ["iteration", "depth_mm", "expected_mm", "standard_error_mm"]
    return charts.Chart(name, title, caption, 3.4, columns, rows, draw)


def _bars(axes: Axes, names: Sequence[str], table: Mapping[str, dict[str, Any]], colour: str) -> None:
    shares = [table[name]["accuracy"] for name in names]
    axes.bar(range(len(names)), shares, color=colour, width=0.7)
    for place, name in enumerate(names):
        axes.plot([place, place], table[name]["ci"], color=charts.INK, linewidth=1.4)
    axes.set_ylim(0, 1.02)
    charts.in_percent(axes.yaxis)


def figure_12(table: Mapping[str, dict[str, Any]]) -> charts.Chart:
    """Human, fixed and human strategy: the paper's three bars, ours, and the fixed position that is best."""
    published = {
        "fixed_average": PUBLISHED["fixed"]["overall"],
        "markov": PUBLISHED["human_strategy"]["overall"],
    }
    rows: list[list[Any]] = [
        ["human", PUBLISHED["human"]["overall"], None, None, None],
        *(
            [ours, published.get(ours), table[ours]["accuracy"], *table[ours]["ci"]]
            for ours in ("fixed_average", "fixed_best", "markov")
        ),
    ]
    names = ["human", "fixed,\naverage", "fixed,\nbest position", "human\nstrategy"]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for at, (_, paper, ours, *interval) in enumerate(rows):
            theirs, own = ("paper", "ours") if at == 1 else ("", "")
            if paper is not None:
                axes.bar(at - 0.19, paper, width=0.35, color=charts.GREY, label=theirs)
            if ours is not None:
                axes.bar(at + 0.19, ours, width=0.35, color=charts.BLUE, label=own)
                axes.plot([at + 0.19] * 2, interval, color=charts.INK, linewidth=1.4)
        axes.set_xticks(range(len(rows)), names)
        axes.axhline(1 / 3, color=charts.INK, linestyle=":", linewidth=1.0, label="chance")
        axes.set_ylim(0, 1.02)
        charts.in_percent(axes.yaxis)
        charts.legend(axes)
        charts.tidy(axes, "", "", "right, %")

    return charts.Chart(
        "figure_12_comparison",
        "Figure 12: human, fixed stiffness, human strategy",
        "Grey: as published. Blue: this study, with 95 % intervals over sessions. The paper compares with "
        "the average of the five fixed positions alone; the best of them, which it leaves out, stands "
        "beside it: the one at which each session's own training is told apart best.",
        3.4,
        ["experiment", "paper", "ours", "low", "high"],
        rows,
        draw,
    )


def policies_chart(table: Mapping[str, dict[str, Any]]) -> charts.Chart:
    """Accuracy of every policy, and beside it what it cost."""
    names = list(table)

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(2, 1, sharex=True)
        _bars(left, names, table, charts.BLUE)
        for level, line, text in (
            (0.9, "-.", "paper, human strategy"),
            (0.667, "--", "paper, fixed"),
            (1 / 3, ":", "chance"),
        ):
            left.axhline(level, color=charts.INK, linestyle=line, linewidth=0.9, label=text)
        charts.legend(left)
        charts.tidy(left, "accuracy, 95 % intervals over sessions", "", "right, %")
        right.bar(range(len(names)), [table[n]["seconds"] for n in names], color=charts.GREEN, width=0.7)
        for place, name in enumerate(names):
            right.annotate(
                f"{table[name]['probes']:.1f}",
                (place, table[name]["seconds"]),
                ha="center",
                fontsize=7,
                va="bottom",
            )
        right.set_xticks(range(len(names)), [n.replace("_", " ") for n in names], rotation=45, ha="right")
        charts.tidy(right, "seconds a trial on the rig; above: probes", "", "s")

    return charts.Chart(
        "policies",
        "Every policy on the same trials",
        "The paper's filter, feature and stop rule verbatim for all. Differences between policies are "
        "within sessions and sharper than the intervals suggest; the table of comparisons tests them.",
        6.0,
        ["policy", "accuracy", "low", "high", "probes", "seconds", "ece"],
        [[n, t["accuracy"], *t["ci"], t["probes"], t["seconds"], t["ece"]] for n, t in table.items()],
        draw,
    )
