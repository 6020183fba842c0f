"""EMG whose bursts and levels are known: how many are found, how many are false, how many levels are right.

By three models (noise in a band, noise shaped as surface EMG, a pool of motor units) under conditions that
were not used to set a threshold, and under conditions drawn for every subject. For comparison: what
somebody reads who knows the contractions' times, or their course; what other rules make of the plain
condition; crosstalk; whether what is held for long stays one burst; and how often
the 95 % intervals of ``palp emg fit-policy`` hold the chain that made the EMG. Shares come with Wilson's 95 %
interval; contractions of one subject share an MVC, so of levels it is too narrow. Tables are written as they
grow: what was measured stays when it is ended early.

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
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.signal import find_peaks

from benchmarks.emg_known import (
    CONDITIONS,
    CROSSTALK,
    EmgCondition,
    Score,
    added,
    contractions,
    coverage,
    judge,
    recorded,
)
from benchmarks.emg_models import MODELS
from palp_core.palpation.perception.emg.analysis import EmgSettings, analyse
from palp_core.palpation.perception.emg.levels import to_levels
from palp_core.palpation.perception.emg.settings import BURSTS, BurstSettings
from palp_core.palpation.perception.strategy.figure5 import LEVELS
from palp_core.palpation.reporting import charts
from palp_core.units import Float64Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEED = 4000
RULES: dict[str, dict[str, Any]] = {
    "plateau, top": {},
    "plateau, peak": {"level_rule": "peak"},
    "maximum of sum, top": {"mvc_rule": "maximum_of_sum"},
    "sum of maxima, top": {"mvc_rule": "sum_of_maxima"},
    "sum of maxima, peak (as printed)": {"mvc_rule": "sum_of_maxima", "level_rule": "peak"},
}
BEFORE = {
    "prominence 0.05, 0.2 s apart, 50 ms": (0.05, 0.2),
    "prominence 0.05, 0.4 s apart, 150 ms": (0.15, 0.4),
}
FITS = {
    "relaxed by 0.9": (0.9, BURSTS.shelf_s),
    "relaxed by 0.9, valleys alone": (0.9, 0.0),
    "relaxed by half": (0.5, BURSTS.shelf_s),
    "relaxed by half, valleys alone": (0.5, 0.0),
}
"""Share of a level that is given up before the next, and ``shelf_s``."""


def wilson(hits: int, of: int) -> tuple[float, float]:
    """Return the 95 % interval of a share."""
    z, share = 1.96, hits / of
    middle, half = share + z * z / (2 * of), z * math.sqrt(share * (1 - share) / of + z * z / (4 * of * of))
    return (middle - half) / (1 + z * z / of), (middle + half) / (1 + z * z / of)


def row_of(table: str, model: str, name: str, one: Score) -> dict[str, Any]:
    """Return a line of the table."""
    low, high = wilson(one.right, one.made)
    told = one.told_course > 0
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
        "told_times_right": one.told_times / one.made if told else None,
        "told_course_right": one.told_course / one.made if told else None,
        "bias": one.bias,
    }


def prominent(values: Float64Array, distance: float) -> list[int]:
    """Return the peaks of half a level's prominence; of those nearer than the distance the highest stay."""
    kept: list[int] = []
    for at in sorted(find_peaks(values, prominence=0.05, plateau_size=1)[0], key=lambda at: -values[at]):
        if all(abs(at - other) >= distance for other in kept):
            kept.append(int(at))
    return kept


def before(window_s: float, distance_s: float, model: str, subjects: int, count: int, seed: int) -> Score:
    """Return what peaks by prominence, held against the sum of maxima, make of the plain condition."""
    settings, of = EmgSettings(window_s=window_s, mvc_rule="sum_of_maxima"), EmgCondition("plain")
    made_count = found = extra = right = 0
    ratios: list[float] = []
    for one in range(subjects):
        rng = np.random.default_rng((seed + one, 15))
        strength, made = contractions(of, count, rng)
        trial, mvc, _ = recorded(model, of, strength, rng)
        values = analyse(trial, mvc, settings).cocontraction
        peaks = prominent(values, distance_s * of.rate_hz)
        for each in made:
            inside = [values[at] for at in peaks if each.begin <= at < each.end + 0.2 * of.rate_hz]
            found += len(inside) == 1
            extra += max(0, len(inside) - 1)
            if inside:
                ratios.append(max(inside) / each.level)
                level = LEVELS[int(to_levels(np.array([max(inside)])).index[0])]
                right += len(inside) == 1 and level == each.level
        made_count += len(made)
    return Score(made_count, found, extra, right, float(np.mean(ratios)) - 1.0)


def sustained(model: str, subjects: int, seed: int) -> dict[str, Any]:
    """Return the bursts and peaks that contractions held for half a minute are taken for."""
    of = EmgCondition("held for 30 s", held_s=(30.0, 30.0), rest_s=(2.0, 2.0))
    bursts, peaks = [], []
    for one in range(subjects):
        rng = np.random.default_rng((seed + one, 17))
        trial, mvc, rest = recorded(model, of, contractions(of, 2, rng)[0], rng)
        found = analyse(trial, mvc, EmgSettings(), rest=rest)
        bursts.append(len(found.bursts) / 2)
        peaks.append(len(found.peaks) / 2)
    return {"model": model, "bursts": float(np.mean(bursts)), "peaks": float(np.mean(peaks))}


def drawn(seed: int) -> EmgCondition:
    """Return a condition between and beside those that are named, another one with every seed."""
    rng = np.random.default_rng((seed, 19))
    shortest, rest = rng.uniform(0.5, 1.5), rng.uniform(0.4, 0.8)
    return EmgCondition(
        "drawn for every subject",
        held_s=(shortest, shortest + rng.uniform(0.4, 3.0)),
        rest_s=(rest, rest + rng.uniform(0.1, 1.5)),
        noise=rng.uniform(0.002, 0.05),
        hum=rng.uniform(0.0, 0.05),
        drift=rng.uniform(0.0, 1.0),
        crosstalk=rng.uniform(0.0, 0.05),
        mvc_s=rng.uniform(3.0, 6.0),
        mvc=str(rng.choice(["held", "fading", "pushes"])),
        rate_hz=float(rng.choice([1000.0, 1500.0, 2048.0])),
    )


def known(model: str, name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Return how a condition is read."""
    of = next(one for one in CONDITIONS if one.name == name)
    settings = EmgSettings(rate_hz=of.rate_hz)
    return row_of("known", model, name, judge(model, of, settings=settings, **_size(options)))


def anew(model: str, name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Return how conditions are read that are drawn for every subject."""
    scores = []
    for one in range(options.seed, options.seed + options.subjects):
        of, size = drawn(one), {**_size(options), "subjects": 1, "seed": one}
        scores.append(judge(model, of, settings=EmgSettings(rate_hz=of.rate_hz), **size))
    return row_of("anew", model, name, added(scores))


def crosstalk(model: str, name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Return how bursts are read with crosstalk between the electrodes."""
    of = next(one for one in CROSSTALK if one.name == name)
    return row_of("crosstalk", model, name, judge(model, of, settings=EmgSettings(), **_size(options)))


def rules(model: str, name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Return what another rule makes of the plain condition."""
    if name in BEFORE:
        one = before(*BEFORE[name], model, **_size(options))
    else:
        one = judge(model, CONDITIONS[0], settings=replace(EmgSettings(), **RULES[name]), **_size(options))
    return row_of("rules", model, name, one)


def fits(model: str, name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Return what intervals hold of the chain that made the EMG."""
    relax_share, shelf_s = FITS[name]
    settings = EmgSettings(bursts=BurstSettings(shelf_s=shelf_s))
    seen = [
        coverage(model, settings, seed=options.seed + number, relax_share=relax_share)
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
    "anew": (anew, ["drawn for every subject"]),
    "crosstalk": (crosstalk, [of.name for of in CROSSTALK]),
    "rules": (rules, [*RULES, *BEFORE]),
    "held": (lambda model, _, options: sustained(model, options.subjects, options.seed), ["for 30 s"]),
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
    told = row["told_times_right"], row["told_course_right"]
    beside = "" if None in told else "  told times {:.1%}, course {:.1%}".format(*told)
    return (
        f"{row['model']:<18} {row['condition']:<36} found {row['found']:6.1%}  false {row['false']:5.1%}  "
        f"levels right {row['levels_right']:6.1%} ({low:.1%} to {high:.1%})  bias {row['bias']:+.1%}{beside}"
    )


def write(found: dict[str, list[dict[str, Any]]], folder: Path) -> None:
    """Write what there is so far: JSON, CSV, and the chart where a model has every condition."""
    (folder / "emg_bursts.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    rows = [row for name in ("known", "anew", "crosstalk", "rules") for row in found.get(name, [])]
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
    """Draw what is wrong, by condition and model, beside the limits."""
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

    title = "What is wrong of what the processing says, by condition and model"
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
