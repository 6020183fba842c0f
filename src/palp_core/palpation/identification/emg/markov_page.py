"""The chart and the page of a fitted strategy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from palp_core.palpation.identification.emg.markov_fit import FittedChain, StrategyFit, chain_file, fit_record
from palp_core.palpation.perception.strategy.chain_file import write_chains
from palp_core.palpation.perception.strategy.figure5 import LEVELS
from palp_core.palpation.reporting.charts import Chart, number
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.whole_file import write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SCALE_END = 0.6  # of the published Figure 5; a chain with a larger entry gets its own


def write_fit(found: StrategyFit, out: Path) -> dict[str, Any]:
    """Write chain.json (which the Markov policy loads), markov.json, the chart, its table and the page."""
    record = fit_record(found)
    out.mkdir(parents=True, exist_ok=True)
    write_chains(chain_file(found), out / "chain.json")
    write_json(out / "markov.json", record)
    write_page(
        out / "index.html",
        "markov_fit.html",
        fit=record,
        levels=[f"level {level:g}" for level in LEVELS],
        matrices=picture(_matrices_chart(found), out),
    )
    return record


def _matrices_chart(found: StrategyFit) -> Chart:
    top = max(_SCALE_END, *(float(one.summary.matrix.max()) for one in found.chains))

    def draw(to: Figure) -> None:
        panels = to.subplots(1, len(found.chains), squeeze=False)[0]
        for axes, one in zip(panels, found.chains, strict=True):
            image = axes.imshow(one.summary.matrix, vmin=0.0, vmax=top, cmap="cividis", origin="lower")
            for row in range(len(LEVELS)):
                for column in range(len(LEVELS)):
                    value = one.summary.matrix[row, column]
                    number(axes, column, row, f"{value:.2f}")
            axes.set_xticks(range(len(LEVELS)), [f"{level:g}" for level in LEVELS])
            axes.set_yticks(range(len(LEVELS)), [f"{level:g}" for level in LEVELS])
            axes.grid(visible=False)
            axes.set_title(f"{_name(one)}, {int(one.summary.posterior.counts.sum())} transitions", loc="left")
            axes.set_xlabel("present level")
            axes.set_ylabel("next level")
        to.colorbar(image, ax=list(panels), shrink=0.7)

    return Chart(
        "matrices",
        "Transition matrices",
        "Posterior mean of M[next, present]; the table beside has every entry's interval.",
        3.2,
        ("depth_mm", "next", "present", "count", "mean", "low", "high"),
        [row for one in found.chains for row in _entries(one)],
        draw,
    )


def _name(one: FittedChain) -> str:
    return "all depths" if one.depth_m is None else f"d = {one.depth_m * 1e3:g} mm"


def _entries(one: FittedChain) -> list[tuple[object, ...]]:
    summary = one.summary
    depth_mm = "" if one.depth_m is None else one.depth_m * 1e3
    return [
        (
            depth_mm,
            LEVELS[i],
            LEVELS[j],
            int(summary.posterior.counts[i, j]),
            float(summary.matrix[i, j]),
            float(summary.low[i, j]),
            float(summary.high[i, j]),
        )
        for j in range(len(LEVELS))
        for i in range(len(LEVELS))
    ]
