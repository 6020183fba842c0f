"""Charts of what came of estimation: the belief over iterations, calibration, ring positions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from palp_core.palpation.perception.statistics import statistics
from palp_core.palpation.reporting import charts
from palp_core.palpation.session.recorded_session import RecordedSession, mm
from palp_core.units import Float64Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def belief_chart(session: RecordedSession) -> charts.Chart | None:
    """Return the expected depth against iteration, Figures 10 and 11; None without a trial."""
    if not session.trials:
        return None
    longest = max(len(trial.probes) for trial in session.trials)
    iterations = np.arange(longest + 1)
    curves = {depth_m: _carried_forward(session, depth_m, longest) * 1e3 for depth_m in session.tried_m}
    running = {
        depth_m: [sum(len(t.probes) >= i for t in session.at_depth(depth_m)) for i in iterations]
        for depth_m in session.tried_m
    }
    means = {depth_m: curve.mean(axis=0) for depth_m, curve in curves.items()}
    errors = {depth_m: _standard_error(curve) for depth_m, curve in curves.items()}

    def draw(figure: Figure) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        for depth_m in curves:
            style = charts.depth_style(session.class_of(depth_m))
            upper.axhline(depth_m * 1e3, color=style["color"], lw=0.8, alpha=0.6)
            upper.errorbar(
                iterations,
                means[depth_m],
                yerr=errors[depth_m],
                capsize=2.5,
                ms=4.5,
                label=f"d = {mm(depth_m)} mm",
                **style,
            )
            lower.step(iterations, running[depth_m], where="mid", label=None, **(style | {"marker": ""}))
        charts.legend(upper)
        lower.set_ylim(bottom=0.0)
        lower.xaxis.get_major_locator().set_params(integer=True)
        charts.tidy(upper, "Expected depth; thin lines: true depth", "", "expected depth, mm")
        charts.tidy(lower, "Trials still running", "iteration (palpation of the trial)", "trials")

    rows = [
        (mm(depth_m), int(i), float(means[depth_m][i]), float(errors[depth_m][i]), running[depth_m][i])
        for depth_m in curves
        for i in iterations
    ]
    return charts.Chart(
        "belief",
        "Estimate over iterations",
        "Posterior expected depth, mean and standard error over this session's trials (as Figures 10 and 11 "
        "of the paper). Iteration 0 is the flat prior. A trial that has ended keeps its last belief, so "
        "every point averages all trials of its depth; below, how many still ran.",
        4.2,
        ("depth_mm", "iteration", "expected_depth_mm", "standard_error_mm", "trials_running"),
        rows,
        draw,
    )


def _carried_forward(session: RecordedSession, depth_m: float, longest: int) -> Float64Array:
    """Return expected depths, m, shape (trials, longest + 1); a trial that has ended keeps its last one."""
    curves = [session.expected_depth_m(trial) for trial in session.at_depth(depth_m)]
    return np.array([np.pad(curve, (0, longest + 1 - curve.size), mode="edge") for curve in curves])


def _standard_error(curves: Float64Array) -> Float64Array:
    count = len(curves)
    if count < 2:
        return np.zeros(curves.shape[1])
    error: Float64Array = curves.std(axis=0, ddof=1) / np.sqrt(count)
    return error


def calibration_chart(session: RecordedSession) -> charts.Chart | None:
    """Return stated confidence against actual accuracy; None without a trial."""
    if not session.trials:
        return None
    found = statistics.calibration(
        np.array([trial.confidence for trial in session.trials]), [trial.right for trial in session.trials]
    )

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot([0, 100], [0, 100], color=charts.GREY, ls="--", lw=1.2, label="deserved confidence")
        for b in found.bins:
            x, y = 100.0 * b.mean_confidence, 100.0 * b.accuracy.value
            reach = [[y - 100.0 * b.accuracy.low], [100.0 * b.accuracy.high - y]]
            axes.errorbar(x, y, yerr=reach, fmt="o", ms=6, capsize=4, color=charts.BLUE)
            axes.annotate(
                f"n = {b.accuracy.trial_count}",
                (x, 100.0 * b.accuracy.high),
                xytext=(0, 4),
                textcoords="offset points",
                ha="center",
                fontsize=8,
            )
        axes.set_xlim(0.0, 105.0)
        axes.set_ylim(-4.0, 110.0)
        charts.legend(axes)
        charts.tidy(axes, "Reliability", "stated probability of the estimate, %", "accuracy, %")

    return charts.Chart(
        "calibration",
        "Calibration",
        "How often estimates of a stated probability were right, in bins of 10 %, n trials each. Expected "
        f"calibration error {100.0 * found.expected_error:.1f} %; mean confidence minus accuracy "
        f"{100.0 * found.overconfidence:+.1f} points (positive is over-confident). The filter takes the "
        "palpations of a trial for independent; errors that stay, as the ring's through a trial and the "
        "mounting's through a phase, can make it over-confident.",
        4.2,
        ("bin_low", "bin_high", "mean_confidence", "accuracy", "low", "high", "trials"),
        [
            (b.low, b.high, b.mean_confidence, a.value, a.low, a.high, a.trial_count)
            for b, a in ((b, b.accuracy) for b in found.bins)
        ],
        draw,
    )


def rings_chart(session: RecordedSession) -> charts.Chart | None:
    probes = [probe for trial in session.trials for probe in trial.probes]
    if not probes:
        return None
    trained = [] if session.primitives is None else session.primitives.rings_m.tolist()
    rings_m = sorted({round(r, 9) for r in [*trained, *(probe.ring_m for probe in probes)]})
    longest = max(probe.iteration for probe in probes)
    counts = np.zeros((longest, len(rings_m)), dtype=np.int64)
    for probe in probes:
        counts[probe.iteration - 1, rings_m.index(round(probe.ring_m, 9))] += 1
    total = counts.sum(axis=0)

    def draw(figure: Figure) -> None:
        overall, by_iteration = figure.subplots(1, 2, width_ratios=(2, 3))
        colours = charts.ring_colours(len(rings_m))
        overall.bar(range(len(rings_m)), 100.0 * total / total.sum(), color=colours, width=0.7)
        overall.set_xticks(range(len(rings_m)), [mm(ring_m) for ring_m in rings_m])
        overall.grid(axis="x", visible=False)
        charts.tidy(overall, "All palpations", "ring position $r_a$, mm", "share, %")
        share = 100.0 * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
        base = np.zeros(longest)
        for k, colour in enumerate(colours):
            by_iteration.bar(
                range(1, longest + 1),
                share[:, k],
                bottom=base,
                color=colour,
                width=0.85,
                label=mm(rings_m[k]),
            )
            base += share[:, k]
        by_iteration.xaxis.get_major_locator().set_params(integer=True)
        by_iteration.grid(axis="x", visible=False)
        by_iteration.set_xlim(0.4, longest + 0.6)
        by_iteration.set_ylim(0.0, 100.0)
        charts.legend(by_iteration, "$r_a$, mm", reverse=True)
        charts.tidy(by_iteration, "By iteration, of the trials still running", "iteration", "share, %")

    return charts.Chart(
        "rings",
        "Ring positions used",
        "Which ring positions r_a the policy chose in estimation: over all palpations, and at each iteration "
        "over the trials that still ran.",
        3.0,
        ("iteration", *(f"palpations_at_{mm(ring_m)}mm" for ring_m in rings_m)),
        [(i + 1, *map(int, counts[i])) for i in range(longest)],
        draw,
    )
