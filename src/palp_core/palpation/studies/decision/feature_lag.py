"""The study ``features``: how late a sweep's feature is known, and how wrong it is, as a stream and offline.

Error against CPU is what ``palp methods measure --task smoother`` charts; lag is what is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.perception.signal.wavelet import edge_cone
from palp_core.palpation.perception.signal.wavelet_stream import tail_weight
from palp_core.palpation.reporting.charts import (
    AMBER,
    BLUE,
    GREEN,
    GREY,
    INK,
    PINK,
    Chart,
    in_percent,
    legend,
    tidy,
)
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.studies.decision.feature_cases import (
    FEATURES,
    FeatureError,
    clean_cases,
    measure,
    ways,
)
from palp_core.palpation.studies.toolkit.pareto import pareto_front
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
    "low_pass": (AMBER, "v"),
    "savitzky_golay": (GREEN, "s"),
    "db10 soft, stream": (BLUE, "o"),
    "db10 approximation, stream": (PINK, "D"),
    "db10 soft, offline": (BLUE, "*"),
    "db10 approximation, offline": (PINK, "P"),
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
    return write_page(
        out / "index.html",
        "studies/features.html",
        rows=rows,
        least=[_least(rows, feature, factor) for factor in NOISE_FACTORS for feature in FEATURES],
        picture=picture(_chart(rows), out),
        tail_weight_at_200=tail_weight(200),
    )


def _least(rows: Sequence[FeatureError], feature: str, noise_factor: float) -> dict[str, FeatureError]:
    """Return the way of the least error, and the default."""
    here = [row for row in rows if row.feature == feature and row.noise_factor == noise_factor]
    default = next(row for row in here if row.way.family == "db10 soft, offline")
    return {"best": min(here, key=lambda row: row.relative), "default": default}


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
    }


def _chart(rows: Sequence[FeatureError]) -> Chart:
    def draw(to: Figure) -> None:
        grid = to.subplots(1, len(FEATURES), squeeze=False, sharey=True)[0]
        for column, feature in enumerate(FEATURES):
            words = "error, % of the gap between depths" if not column else ""
            tidy(grid[column], feature, "lag, s (0 drawn at 1 ms)", words)
            for factor in NOISE_FACTORS:
                here = [r for r in rows if r.feature == feature and r.noise_factor == factor]
                _panel(grid[column], here, filled=factor == NOISE_FACTORS[0])
        in_percent(grid[0].yaxis)
        handles, labels = grid[0].get_legend_handles_labels()
        legend(to, handles=handles, labels=labels, ncols=4, fontsize=7)

    return Chart(
        "features",
        "Error of the feature against lag",
        "Filled: noise of one step of the resolution; open: five steps. Lines: what nothing beats in both.",
        4.2,
        ("family", "setting", "lag_s", "noise_steps", "feature", "rms_n_m", "bias_n_m", "relative"),
        [tuple(_record(row).values()) for row in rows],
        draw,
    )


def _panel(axes: Axes, rows: Sequence[FeatureError], *, filled: bool) -> None:
    x = [max(r.way.lag_s, _LEAST_LAG_S) for r in rows]
    y = [r.relative for r in rows]
    best = pareto_front(x, y)
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
