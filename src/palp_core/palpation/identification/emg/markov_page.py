"""The chart and the page of a fitted strategy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from palp_core.palpation.identification.emg.markov_fit import FittedChain, StrategyFit, chain_file, fit_record
from palp_core.palpation.perception.strategy.chain_file import write_chains
from palp_core.palpation.perception.strategy.figure5 import LEVELS
from palp_core.palpation.reporting.charts import Chart
from palp_core.palpation.reporting.html_page import figure, paragraph, table, write_page
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
    parts = [
        paragraph(_lead(record), "lead"),
        figure(_matrices_chart(found), out),
        "<h2>What each chain says</h2>",
        table(
            [
                "trials of",
                "transitions",
                "|lambda_2|",
                "relaxation, steps",
                "Kemeny, steps",
                "structure seen",
            ],
            [_line(one) for one in record["chains"]],
        ),
        "<h2>Eigenvalues</h2>",
        table(
            ["trials of", *(f"{i + 1}" for i in range(len(LEVELS)))],
            [
                [_depth(one), *(_eigenvalue(value) for value in one["eigenvalues"])]
                for one in record["chains"]
            ],
        ),
        "<h2>Long run under the three readings of eqs. (4) and (5)</h2>",
        table(
            ["trials of", "reading", *(f"level {level:g}" for level in LEVELS), "freezes"],
            [
                [_depth(one), name, *(f"{share:.2f}" for share in run["law"]), _frozen(run)]
                for one in record["chains"]
                for name, run in one["readings"].items()
            ],
        ),
    ]
    write_page(out, "Strategy learnt from EMG", parts)
    return record


def _lead(record: dict[str, Any]) -> str:
    used, pooled = record["settings"], record["chains"][0]
    return (
        f"{pooled['transitions']} transitions between {pooled['bursts']} bursts, {pooled['trials']} trials; "
        f"RMS window {1e3 * used['window_s']:g} ms, prominence {used['prominence']:g}, at least "
        f"{used['distance_s']:g} s apart. Each column has a Dirichlet prior of {used['prior_count']:g} a "
        f"transition; intervals hold {100.0 * used['interval_mass']:g} %. They span the transitions that "
        "were counted, not what the peak rule missed, nor other subjects. `chain.json` can be loaded by the "
        "Markov policy."
    )


def _depth(one: dict[str, Any]) -> str:
    return "all depths" if one["depth_mm"] is None else f"{one['depth_mm']:g} mm"


def _interval(value: dict[str, float], form: str = ".2f") -> str:
    return f"{value['value']:{form}} ({value['low']:{form}} to {value['high']:{form}})"


def _line(one: dict[str, Any]) -> list[str]:
    seen = one["observed"]
    words = ["irreducible" if seen["irreducible"] else f"{seen['closed_classes']} closed classes, reducible"]
    if seen["period"] > 1:
        words.append(f"period {seen['period']}")
    for key, said in (("levels_never_visited", "never visited"), ("levels_never_left", "never left")):
        if seen[key]:
            words.append(f"levels {', '.join(map(str, seen[key]))} {said}")
    return [
        _depth(one),
        str(one["transitions"]),
        _interval(one["eigenvalues"][1]["modulus"], ".3f"),
        _interval(one["relaxation_time_steps"]),
        _interval(one["kemeny_steps"]),
        "; ".join(words),
    ]


def _eigenvalue(value: dict[str, Any]) -> str:
    turn = f" {value['imaginary']:+.4f}i" if abs(value["imaginary"]) > 1e-9 else ""
    return f"{value['real']:.4f}{turn}"


def _frozen(run: dict[str, Any]) -> str:
    return "no" if run["frozen_after"] is None else f"after {run['frozen_after']} steps"


def _matrices_chart(found: StrategyFit) -> Chart:
    top = max(_SCALE_END, *(float(one.summary.matrix.max()) for one in found.chains))

    def draw(to: Figure) -> None:
        panels = to.subplots(1, len(found.chains), squeeze=False)[0]
        for axes, one in zip(panels, found.chains, strict=True):
            image = axes.imshow(one.summary.matrix, vmin=0.0, vmax=top, cmap="cividis", origin="lower")
            for row in range(len(LEVELS)):
                for column in range(len(LEVELS)):
                    value = one.summary.matrix[row, column]
                    ink = "black" if value > 0.55 * top else "white"
                    axes.text(column, row, f"{value:.2f}", ha="center", va="center", color=ink, fontsize=7)
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
        (1.2 + 3.1 * len(found.chains), 3.2),
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
