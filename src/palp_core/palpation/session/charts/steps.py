"""One trial step by step: sweep, what was read off it, how likely each depth makes that, and the belief."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.counted import counted
from palp_core.errors import PalpError
from palp_core.palpation.perception.signal.wavelet import denoise
from palp_core.palpation.reporting.charts import BLUE, GREY, INK, VERMILION, Chart, depth_style, legend, tidy
from palp_core.palpation.session.charts.training import normal_of, stage_axis
from palp_core.palpation.session.recorded_session import RecordedSession, RecordedTrial, mm
from palp_core.palpation.session.trials_csv import Row, read_sweep
from palp_core.units import Float64Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST = 4
_log = logging.getLogger("palp")


def steps_chart(
    session: RecordedSession, *, estimator: Mapping[str, Any], from_m: float | None, speed_m_s: float
) -> Chart | None:
    """Return the chart of a trial of middling length; None where no trial can be shown."""
    trial, learnt = _middling(session.trials), session.primitives
    if trial is None or learnt is None or estimator.get("reading", "feature") != "feature":
        return None
    shown = trial.probes if len(trial.probes) <= _MOST else (*trial.probes[: _MOST - 1], trial.probes[-1])
    settings = {k: v for k, v in estimator.items() if k in ("wavelet", "level")}
    try:
        raw = [read_sweep(session.folder, probe.row) for probe in shown]
    except PalpError as error:
        _log.warning("no chart of a trial: %s", error)
        return None
    clean = [
        1e3 * denoise(one, rule=estimator.get("denoise", "soft_universal"), **settings) for one, _ in raw
    ]
    rings = [int(np.argmin(np.abs(learnt.rings_m - probe.ring_m))) for probe in shown]
    likelihoods = [
        _normalised(learnt.log_likelihood(p.peak_n_m, k)) for p, k in zip(shown, rings, strict=True)
    ]
    feature = estimator.get("feature", "peak")
    names = [f"{mm(depth_m)} mm" for depth_m in session.depths_m]

    def draw(figure: Figure) -> None:
        grid = figure.subplots(3, len(shown), squeeze=False, sharey="row", height_ratios=(3, 3, 2))
        for column, (probe, k) in enumerate(zip(shown, rings, strict=True)):
            sweep, taught, belief = grid[:, column]
            along, label, _ = stage_axis(len(clean[column]), speed_m_s / raw[column][1], from_m)
            sweep.plot(along, 1e3 * raw[column][0], color=GREY, lw=0.5)
            sweep.plot(along, clean[column], color=BLUE, lw=1.4)
            sweep.axhline(1e3 * probe.peak_n_m, color=VERMILION, lw=1.0, ls="--")
            title = f"{probe.iteration}: $r_a$ = {mm(probe.ring_m)} mm"
            tidy(sweep, title, label.replace("stage position past", "past"), "" if column else "torque, N mm")
            normals = [normal_of(learnt, i, k) for i in range(learnt.depths_m.size)]
            highest = max(density.max() for _, density in normals)
            for i, (torque, density) in enumerate(normals):
                look = depth_style(i) | {"marker": ""}
                taught.plot(
                    torque, density / highest, lw=1.6, label=f"d = {mm(learnt.depths_m[i])} mm", **look
                )
            taught.axvline(1e3 * probe.peak_n_m, color=VERMILION, lw=1.2, ls="--", label=f"{feature} read")
            tidy(taught, "", f"{feature}, N mm", "" if column else "likelihood, scaled")
            _bars(belief, probe, names, session.class_of(trial.depth_m), first=column == 0)
        handles, words = grid[1, 0].get_legend_handles_labels()
        legend(figure, handles=handles, labels=words, ncols=len(words))

    return Chart(
        "steps",
        "One trial, step by step",
        f"Trial {shown[0].trial}, over phantom {shown[0].phantom}, the true depth {mm(trial.depth_m)} mm: "
        f"{counted(len(trial.probes), 'palpation')}, {_ending(trial)}. "
        + (f"Shown are the first {_MOST - 1} and the last. " if len(shown) < len(trial.probes) else "")
        + f"Above: the sweep as measured (grey) and de-noised (blue), and the {feature} read off it "
        "(dashed). Middle: what training taught at that ring position, the highest curve scaled to 1; where "
        "the dashed line meets them is how likely each depth makes the reading. Below: the posterior after "
        "it; the rimmed bar is the true depth, and the words say whether the stop rule went on.",
        5.4,
        (
            *("trial", "iteration", "ring_mm", f"{feature}_n_mm"),
            *(f"likelihood_share_{mm(d)}mm" for d in learnt.depths_m),
            *(f"posterior_{mm(d)}mm" for d in session.depths_m),
            "verdict",
        ),
        [
            (
                p.trial,
                p.iteration,
                mm(p.ring_m),
                1e3 * p.peak_n_m,
                *likelihood.tolist(),
                *p.posterior,
                p.verdict,
            )
            for p, likelihood in zip(shown, likelihoods, strict=True)
        ],
        draw,
    )


def _middling(trials: Sequence[RecordedTrial]) -> RecordedTrial | None:
    """Return the first trial of the median number of palpations, of those that ended decided if any did."""
    of = [trial for trial in trials if trial.verdict == "decided"] or list(trials)
    if not of:
        return None
    lengths = sorted(len(trial.probes) for trial in of)
    wanted = lengths[len(lengths) // 2]
    return next(trial for trial in of if len(trial.probes) == wanted)


def _ending(trial: RecordedTrial) -> str:
    estimate_m = trial.probes[-1].estimate_m
    taken = (
        "without an estimate"
        if estimate_m is None
        else f"{mm(estimate_m)} mm at {100 * trial.confidence:.0f} %"
    )
    return f"{trial.verdict}: {taken}, {'right' if trial.right else 'wrong'}"


def _normalised(log: Float64Array) -> Float64Array:
    found = np.exp(log - log.max())
    return np.asarray(found / found.sum())


def _bars(axes: Axes, probe: Row, names: Sequence[str], true: int, *, first: bool) -> None:
    colours = [depth_style(i)["color"] for i in range(len(names))]
    rims = [2.0 if i == true else 0.0 for i in range(len(names))]
    axes.bar(
        range(len(names)), [100 * p for p in probe.posterior], color=colours, edgecolor=INK, linewidth=rims
    )
    axes.set_xticks(range(len(names)), names, fontsize=7 if len(names) > 3 else 8)
    axes.set_ylim(0.0, 105.0)
    axes.grid(axis="x", visible=False)
    tidy(
        axes, "goes on" if probe.verdict == "continue" else probe.verdict, "", "posterior, %" if first else ""
    )
