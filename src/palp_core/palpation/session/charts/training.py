"""Charts of what was learnt: the memory primitives, and the sweeps they come from."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.palpation.perception.signal.features import peak
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.reporting import charts
from palp_core.palpation.session.recorded_session import RecordedSession, mm
from palp_core.palpation.session.trials_csv import read_sweep
from palp_core.units import Float64Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_SWEEPS = 25
"""Training sweeps per ring position that the chart of sweeps reads, the published number."""
_ZOOM_M = 0.006
_log = logging.getLogger("palp")


def primitives_chart(session: RecordedSession) -> charts.Chart | None:
    """Return the normals of Figure 9, a panel per ring position; None where nothing was learnt."""
    learnt = session.primitives
    if learnt is None:
        return None
    panel_count = learnt.rings_m.size
    columns = min(panel_count, 3)
    lines = -(-panel_count // columns)

    def draw(figure: Figure) -> None:
        grid = figure.subplots(lines, columns, squeeze=False)
        for k, axes in enumerate(grid.flat):
            if k < panel_count:
                for i in range(learnt.depths_m.size):
                    torque, density = normal_of(learnt, i, k)
                    style = charts.depth_style(i) | {"marker": ""}
                    axes.plot(torque, density, label=f"d = {mm(learnt.depths_m[i])} mm", lw=1.8, **style)
                    axes.fill_between(torque, density, color=style["color"], alpha=0.12, lw=0)
                axes.set_ylim(bottom=0.0)
                axes.locator_params(axis="x", nbins=5)
                charts.tidy(
                    axes, f"$r_a$ = {mm(learnt.rings_m[k])} mm", "peak torque, N mm", "density, 1/(N mm)"
                )
            else:
                axes.set_axis_off()
        handles = grid.flat[0].get_lines()
        charts.legend(figure, handles=handles, ncols=len(handles))

    rows = [
        (mm(depth_m), mm(ring_m), learnt.mean[i, k] * 1e3, learnt.sd[i, k] * 1e3, int(learnt.count[i, k]))
        for i, depth_m in enumerate(learnt.depths_m)
        for k, ring_m in enumerate(learnt.rings_m)
    ]
    return charts.Chart(
        "primitives",
        "Memory primitives",
        "The normal fitted to the peak torques of training, per depth d and ring position r_a "
        f"({_span(learnt.count)} palpations each; as Figure 9 of the paper). Each panel has its own scales: "
        "the more the curves overlap, the less a palpation at that position shows.",
        2.4 * lines + 0.4,
        ("depth_mm", "ring_mm", "mean_n_mm", "sd_n_mm", "palpations"),
        rows,
        draw,
    )


def _span(count: Float64Array) -> str:
    low, high = int(count.min()), int(count.max())
    return f"{low}" if low == high else f"{low} to {high}"


def normal_of(learnt: Primitives, i: int, k: int) -> tuple[Float64Array, Float64Array]:
    """Return torque in N mm and density per N mm within four deviations of a primitive."""
    mean, sd = learnt.mean[i, k] * 1e3, learnt.sd[i, k] * 1e3
    z = np.linspace(-4.0, 4.0, 161)
    return mean + sd * z, np.exp(-0.5 * z**2) / (sd * np.sqrt(2.0 * np.pi))


def sweeps_chart(
    session: RecordedSession, *, estimator: Mapping[str, Any], from_m: float | None, speed_m_s: float
) -> charts.Chart | None:
    """Return the sweeps of Figure 8 over the deepest bead: one as measured, and the mean per ring."""
    training = session.training
    if not training:
        return None
    depth_m = max(row.depth_m for row in training)
    rings_m = sorted({row.ring_m for row in training})
    chosen = {
        ring_m: [r for r in training if r.depth_m == depth_m and r.ring_m == ring_m][:MOST_SWEEPS]
        for ring_m in rings_m
    }
    chosen = {ring_m: rows for ring_m, rows in chosen.items() if rows}
    settings = {k: v for k, v in estimator.items() if k in ("wavelet", "level")}
    rule = estimator.get("denoise", "soft_universal")
    try:
        raw = {
            ring_m: [read_sweep(session.folder, r.row)[0] for r in rows] for ring_m, rows in chosen.items()
        }
        rate_hz = read_sweep(session.folder, training[0].row)[1]
    except PalpError as error:
        _log.warning("no chart of the sweeps: %s", error)
        return None
    length = min(len(sweep) for sweeps in raw.values() for sweep in sweeps)
    clean = {
        ring_m: np.array([denoise(sweep, rule=rule, **settings)[:length] for sweep in sweeps])
        for ring_m, sweeps in raw.items()
    }
    edge = edge_cone(**settings)
    along, along_label, per_sample = stage_axis(length, speed_m_s / rate_hz, from_m)
    means = {ring_m: sweeps.mean(axis=0) * 1e3 for ring_m, sweeps in clean.items()}
    deviations = {ring_m: _sd(sweeps) * 1e3 for ring_m, sweeps in clean.items()}
    peaks = {ring_m: peak(mean, edge=edge) for ring_m, mean in means.items()}
    shown_m = max(raw)
    one = peak(clean[shown_m][0], edge=edge)
    step = max(length // 800, 1)  # more points than a page has pixels would only make it large

    def draw(figure: Figure) -> None:
        near, whole = figure.subplots(1, 2, width_ratios=(2, 3))
        half = round(_ZOOM_M * 1e3 / per_sample)
        window = slice(max(one.index - half, 0), min(one.index + half, length))
        measured = raw[shown_m][0][:length] * 1e3
        near.plot(along[window], measured[window], ".", ms=2.2, color=charts.GREY, label="as measured")
        near.plot(
            along[window], clean[shown_m][0][window] * 1e3, color=charts.BLUE, lw=1.8, label="de-noised"
        )
        near.plot(along[one.index], one.value_n_m * 1e3, "v", ms=8, color=charts.VERMILION, label="peak")
        charts.tidy(
            near, f"One palpation near its peak, $r_a$ = {mm(shown_m)} mm", along_label, "torque, N mm"
        )
        for colour, ring_m in zip(charts.ring_colours(len(means)), means, strict=True):
            x, mean, sd = along[::step], means[ring_m][::step], deviations[ring_m][::step]
            whole.fill_between(x, mean - sd, mean + sd, color=colour, alpha=0.25, lw=0)
            whole.plot(x, mean, color=colour, lw=1.6)
            found = peaks[ring_m]
            whole.plot(along[found.index], found.value_n_m, "v", ms=7, color=colour, mec=charts.INK, mew=0.6)
            whole.annotate(
                f"$r_a$ = {mm(ring_m)}",
                (x[-1], mean[-1]),
                xytext=(4, 0),
                textcoords="offset points",
                va="center",
                fontsize=8,
            )
        charts.legend(figure, handles=near.get_lines(), ncols=3)
        charts.tidy(whole, f"Mean ± sd per ring position, d = {mm(depth_m)} mm", along_label, "torque, N mm")

    shown = [
        (mm(ring_m), float(along[i]), float(means[ring_m][i]), float(deviations[ring_m][i]))
        for ring_m in means
        for i in range(0, length, step)
    ]
    return charts.Chart(
        "sweeps",
        "Torque while sweeping",
        f"Training over the bead at d = {mm(depth_m)} mm (as Figure 8 of the paper). Left: a palpation as "
        "measured and de-noised, near its peak. Right: mean and standard deviation of the de-noised sweeps "
        f"(up to {MOST_SWEEPS} per ring position r_a, in mm); triangles mark the peaks, searched for where "
        "the ends of the sweep have no influence.",
        3.7,
        ("ring_mm", along_label.replace(", ", "_").replace(" ", "_"), "mean_n_mm", "sd_n_mm"),
        shown,
        draw,
    )


def _sd(sweeps: Float64Array) -> Float64Array:
    """Return the deviation of each sample over the sweeps; 0 for a single sweep."""
    deviation: Float64Array = sweeps.std(axis=0, ddof=1) if len(sweeps) > 1 else np.zeros(sweeps.shape[1])
    return deviation


def stage_axis(length: int, step_m: float, from_m: float | None) -> tuple[Float64Array, str, float]:
    """Return where each sample lies, the axis' name, and the step between samples, mm."""
    step_mm = step_m * 1e3
    way_mm = step_mm * np.arange(length, dtype=np.float64)
    if from_m is None:
        return way_mm, "way of the stage, mm", step_mm
    return from_m * 1e3 + way_mm, "stage position past the bead, mm", step_mm
