"""The study ``features``: how wrong a sweep's feature is, how late it is known, and what it costs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.perception.signal.wavelet import edge_cone
from palp_core.palpation.perception.signal.wavelet_stream import tail_weight
from palp_core.palpation.reporting.charts import GREY, INK, Chart, tidy
from palp_core.palpation.reporting.html_page import figure, paragraph, table, write_page
from palp_core.palpation.studies.decision.feature_cases import (
    FEATURES,
    FeatureError,
    clean_cases,
    measure,
    ways,
)
from palp_core.palpation.studies.toolkit.progress import followed
from palp_core.whole_file import write_json

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RINGS_M = (0.004, 0.016)
NOISE_FACTORS = (1.0, 5.0)
SEED = 20
_STYLE = {
    "none": (GREY, "x"),
    "low_pass": ("#E69F00", "v"),
    "savitzky_golay": ("#009E73", "s"),
    "db10 soft, stream": ("#0072B2", "o"),
    "db10 approximation, stream": ("#CC79A7", "D"),
    "db10 soft, offline": ("#0072B2", "*"),
    "db10 approximation, offline": ("#CC79A7", "P"),
}
_LEAST_LAG_S = 1e-3


def run(out: Path, *, quick: bool = False) -> Path:
    """Measure every way, write chart, table, JSON and the page, and return the page.

    Args:
        out: Folder for the files; made if missing.
        quick: Fewer settings and sweeps.
    """
    cases = clean_cases(RINGS_M)
    rows = [
        row
        for noise_factor in NOISE_FACTORS
        for way in followed(f"ways, noise {noise_factor:g}", ways(quick=quick))
        for row in measure(way, cases, noise_factor, 5 if quick else 60, np.random.default_rng(SEED))
    ]
    out.mkdir(parents=True, exist_ok=True)
    record = {
        "seed": SEED,
        "rings_m": RINGS_M,
        "ways": [_record(row) for row in rows],
        "tail_weight": {str(lag): tail_weight(lag) for lag in (0, 50, 100, 200, 300, 400, edge_cone())},
    }
    write_json(out / "features.json", record)
    parts = [
        paragraph(_lead(rows), "lead"),
        figure(_chart(rows), out),
        "<h2>How to read it</h2>",
        paragraph(
            "Simulated sweeps over the paper's three depths at r_a = 4 and 16 mm, with the sensor's noise of "
            "one and five steps of its resolution (the first assumed). The error is that of the feature "
            "against the same "
            "feature of the sweep without noise, over the least distance to another depth's at that ring: "
            "at 0.5 two depths would be confused by it alone. Shared errors of ring and mounting are not in "
            "it; they are larger, and no smoothing touches them. Lag is the time after a sample at which its "
            "value is known; blocks of 50 samples add up to 50 ms. Offline ways are charted at the length of "
            "the sweep. Cost is CPU for a sweep of 4 s, the feature included, on this machine. Lines join "
            "what nothing else beats in both."
        ),
        paragraph(
            "A stream that is late by the edge cone, 589 samples, equals the offline result to rounding; by "
            "200, the linear rule differs by at most "
            f"{100.0 * tail_weight(200):.2g} % of what the sweep still does. The soft rule's threshold is "
            "then the sensor's stated noise, not the sweep's."
        ),
        "<h2>Numbers</h2>",
        table(
            [
                "way",
                "setting",
                "lag, ms",
                "noise",
                "feature",
                "rms, N mm",
                "bias, N mm",
                "of gap",
                "cost, ms",
            ],
            [
                [
                    r.way.family,
                    r.way.label,
                    f"{1e3 * r.way.lag_s:.0f}",
                    f"{r.noise_factor:g} steps",
                    r.feature,
                    f"{1e3 * r.rms_n_m:.4f}",
                    f"{1e3 * r.bias_n_m:+.4f}",
                    f"{r.relative:.3f}",
                    f"{1e3 * r.cost_s:.2f}",
                ]
                for r in rows
            ],
        ),
    ]
    return write_page(out, "Features of a sweep: error against lag and cost", parts)


def _lead(rows: Sequence[FeatureError]) -> str:
    said = []
    for factor in NOISE_FACTORS:
        for feature in FEATURES:
            here = [r for r in rows if r.feature == feature and r.noise_factor == factor]
            best = min(here, key=lambda r: r.relative)
            default = next(r for r in here if r.way.family == "db10 soft, offline")
            said.append(
                f"{feature} at {factor:g} steps: {best.way.family} {best.way.label} "
                f"{best.relative:.3f} of the gap, the default {default.relative:.3f}"
            )
    return f"Least error, {'; '.join(said)}."


def _record(row: FeatureError) -> dict[str, Any]:
    return {
        "family": row.way.family,
        "setting": row.way.label,
        "lag_s": row.way.lag_s,
        "noise_factor": row.noise_factor,
        "feature": row.feature,
        "rms_n_m": row.rms_n_m,
        "bias_n_m": row.bias_n_m,
        "relative": row.relative,
        "cost_s": row.cost_s,
    }


def front(x: Sequence[float], y: Sequence[float]) -> list[int]:
    """Return the indices that nothing beats in both, by rising x."""
    found: list[int] = []
    for i in sorted(range(len(x)), key=lambda i: (x[i], y[i])):
        if not found or y[i] < y[found[-1]]:
            found.append(i)
    return found


def _chart(rows: Sequence[FeatureError]) -> Chart:
    def draw(to: Figure) -> None:
        grid = to.subplots(len(FEATURES), 2, squeeze=False, sharey="row")
        for line, feature in enumerate(FEATURES):
            for column, what in enumerate(("lag", "cost")):
                title = f"{feature}, against {what}"
                unit = "lag, s (0 drawn at 1 ms)" if what == "lag" else "CPU for a sweep, s"
                tidy(grid[line][column], title, unit, "error over gap between depths" if not column else "")
                for factor in NOISE_FACTORS:
                    here = [r for r in rows if r.feature == feature and r.noise_factor == factor]
                    _panel(grid[line][column], here, what, filled=factor == NOISE_FACTORS[0])
        handles, labels = grid[0][0].get_legend_handles_labels()
        to.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=7)

    return Chart(
        "features",
        "Error of the feature against lag and cost",
        "Filled: noise of one step of the resolution; open: five steps. Lines: what nothing beats in both.",
        (8.4, 7.2),
        ("family", "setting", "lag_s", "noise_steps", "feature", "rms_n_m", "bias_n_m", "relative", "cost_s"),
        [tuple(_record(row).values()) for row in rows],
        draw,
    )


def _panel(axes: Axes, rows: Sequence[FeatureError], what: str, *, filled: bool) -> None:
    x = [max(r.way.lag_s, _LEAST_LAG_S) if what == "lag" else r.cost_s for r in rows]
    y = [r.relative for r in rows]
    best = front(x, y)
    axes.plot(
        [x[i] for i in best], [y[i] for i in best], color=INK, lw=0.9, ls="-" if filled else ":", zorder=1
    )
    for family, (colour, marker) in _STYLE.items():
        at = [i for i, r in enumerate(rows) if r.way.family == family]
        axes.scatter(
            [x[i] for i in at],
            [y[i] for i in at],
            marker=marker,
            s=34,
            zorder=3,
            linewidths=1.0,
            label=family if filled else None,
            facecolors=colour if filled or marker == "x" else "none",
            edgecolors=None if marker == "x" else colour,
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
