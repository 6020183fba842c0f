"""EMG whose bursts and levels are known: how many are found, how many are false, how many levels are right.

By three models (noise in a band, noise shaped as surface EMG, a pool of motor units) under conditions that
were not used to set a threshold, crosstalk among them; and how often the 95 % intervals of
``palp emg fit-policy`` hold the chain that made the EMG. Shares come with Wilson's 95 % interval, which is
too narrow for levels: contractions of one subject share an MVC. Tables are written as they grow.

Run: .venv/bin/python -m benchmarks.emg_bursts [--out DIR] [--subjects 15] [--count 40] [--fits 10]
     [--seed 4000] [--models "motor units"] [--only known crosstalk] [--workers 1] [--quick]
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


from benchmarks.emg_known import (
    CONDITIONS,
    CROSSTALK,
    Score,
    coverage,
    judge,
)
from benchmarks.emg_models import MODELS
from palp_core.palpation.perception.emg.analysis import EmgSettings
from palp_core.palpation.reporting import charts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEED = 4000
FITS = {
    "relaxed by 0.9": 0.9,
    "relaxed by half": 0.5,
}
"""Share of a level that is given up before the next."""


def wilson(hits: int, of: int) -> tuple[float, float]:
    """Return the 95 % interval of a share."""
    z, share = 1.96, hits / of
    middle, half = share + z * z / (2 * of), z * math.sqrt(share * (1 - share) / of + z * z / (4 * of * of))
    return (middle - half) / (1 + z * z / of), (middle + half) / (1 + z * z / of)


def row_of(table: str, model: str, name: str, one: Score) -> dict[str, Any]:
    """Return a line of the table."""
    low, high = wilson(one.right, one.made)
    return {
        "table": table,
        "model": model,
        "condition": name,
        "made": one.made,
        "found": one.found / one.made,
        "false": one.false / one.made,
        "levels_right": one.right / one.made,
        "levels_right_low": low,
        "levels_right_high": high,
        "bias": one.bias,
    }


def known(model: str, name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Return how a condition is read."""
    of = next(one for one in CONDITIONS if one.name == name)
    settings = EmgSettings(rate_hz=of.rate_hz)
    return row_of("known", model, name, judge(model, of, settings=settings, **_size(options)))


def crosstalk(model: str, name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Return how bursts are read with crosstalk between the electrodes."""
    of = next(one for one in CROSSTALK if one.name == name)
    return row_of("crosstalk", model, name, judge(model, of, settings=EmgSettings(), **_size(options)))


def fits(model: str, name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Return what intervals hold of the chain that made the EMG."""
    seen = [
        coverage(model, EmgSettings(), seed=options.seed + number, relax_share=FITS[name])
        for number in range(options.fits)
    ]
    return {
        "model": model,
        "fit": name,
        "entries_of_25": [one.entries for one in seen],
        "shares_of_5": [one.shares for one in seen],
        "transitions": [one.transitions for one in seen],
    }


TABLES: dict[str, tuple[Callable[[str, str, argparse.Namespace], dict[str, Any]], Sequence[str]]] = {
    "known": (known, [of.name for of in CONDITIONS]),
    "crosstalk": (crosstalk, [of.name for of in CROSSTALK]),
    "fits": (fits, list(FITS)),
}
"""What is measured of every model, by table: how, and its lines."""


def _size(options: argparse.Namespace) -> dict[str, int]:
    return {"subjects": options.subjects, "count": options.count, "seed": options.seed}


def measure(job: tuple[str, str, str, argparse.Namespace]) -> tuple[str, dict[str, Any]]:
    """Return a line of a table."""
    table, model, name, options = job
    return table, TABLES[table][0](model, name, options)


def line(row: dict[str, Any]) -> str:
    """Return a row as text."""
    if "condition" not in row:
        return str(row)
    low, high = row["levels_right_low"], row["levels_right_high"]
    return (
        f"{row['model']:<18} {row['condition']:<36} found {row['found']:6.1%}  false {row['false']:5.1%}  "
        f"levels right {row['levels_right']:6.1%} ({low:.1%} to {high:.1%})  bias {row['bias']:+.1%}"
    )


def write(found: dict[str, list[dict[str, Any]]], folder: Path) -> None:
    """Write what there is so far: JSON, CSV, and the chart where a model has every condition."""
    (folder / "emg_bursts.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    rows = [row for name in ("known", "crosstalk") for row in found.get(name, [])]
    if not rows:
        return
    with (folder / "emg_bursts.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(
            {key: f"{value:.4f}" if isinstance(value, float) else value for key, value in row.items()}
            for row in rows
        )
    draw(found.get("known", []), folder / "emg_bursts.png")


def draw(known_rows: list[dict[str, Any]], target: Path) -> None:
    """Draw what is wrong, by condition and model, with the limits."""
    names = [of.name for of in CONDITIONS]
    wrong = (
        ("bursts not found, %", "found", 1.0),
        ("false bursts, %", "false", 1.0),
        ("levels wrong, %", "levels_right", 2.0),
    )

    def panels(figure: Figure) -> None:
        found = figure.subplots(1, 3, sharey=True)
        for axes, (title, key, limit) in zip(found, wrong, strict=True):
            for place, model in enumerate(MODELS):
                rows = [row for row in known_rows if row["model"] == model]
                values = [100.0 * (row[key] if key == "false" else 1.0 - row[key]) for row in rows]
                heights = [names.index(row["condition"]) + 0.2 * (place - 1) for row in rows]
                look = charts.depth_style(place) | {"linestyle": ""}
                axes.plot(values, heights, label=model, markersize=5, **look)
            axes.axvline(limit, color=charts.GREY, linestyle="--", linewidth=1.0)
            axes.set_xscale("symlog", linthresh=1.0)
            axes.set_xlim(-0.1, 100.0)
            charts.tidy(axes, title, "", "")
        found[0].set_yticks(range(len(names)), names)
        found[0].invert_yaxis()
        charts.legend(figure, ncols=len(MODELS), handles=found[0].get_legend_handles_labels()[0])

    title = "What is read wrong, by condition and model"
    picture = charts.Chart("emg_bursts", title, "", 5.5, (), (), panels, width=10.0)
    target.write_bytes(charts.image(picture, "png"))


def main() -> None:
    """Measure, print, and write JSON, CSV and a chart."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("results/emg_bursts"))
    parser.add_argument("--subjects", type=int, default=15, help="each with an MVC of its own")
    parser.add_argument("--count", type=int, default=40, help="contractions of each")
    parser.add_argument("--fits", type=int, default=10, help="strategies learnt, of 15 trials each")
    parser.add_argument("--seed", type=int, default=SEED, help="of the first subject")
    parser.add_argument("--models", nargs="+", choices=list(MODELS), default=list(MODELS))
    parser.add_argument("--only", nargs="+", choices=list(TABLES), default=list(TABLES), help="tables")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="2 subjects of 10, 1 fit")
    options = parser.parse_args()
    if options.quick:
        options.subjects, options.count, options.fits = 2, 10, 1
    jobs = [
        (table, model, name, options)
        for table in options.only
        for model in options.models
        for name in TABLES[table][1]
    ]
    options.out.mkdir(parents=True, exist_ok=True)
    found: dict[str, list[dict[str, Any]]] = {}
    with ProcessPoolExecutor(options.workers) as pool:
        for table, row in pool.map(measure, jobs):
            found.setdefault(table, []).append(row)
            print(line(row), flush=True)
            write(found, options.out)


if __name__ == "__main__":
    main()
