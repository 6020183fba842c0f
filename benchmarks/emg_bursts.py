"""EMG whose bursts and levels are known: how many are found, how many are false, how many levels are right.

By three models (noise in a band, noise shaped as surface EMG, a pool of motor units) under conditions that
were not used to set a threshold; beside it what other rules make of the plain condition, whether what is
held for long stays one burst, and how often ``palp markov fit``'s 95 % intervals hold the chain that made the
EMG. Shares come with Wilson's 95 % interval; contractions of one subject share an MVC, so of levels it is too
narrow.

Run: .venv/bin/python benchmarks/emg_bursts.py [--out DIR] [--subjects 15] [--count 40] [--fits 10] [--quick]
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from palp_core.palpation.perception.emg.analysis import EmgSettings, analyse
from palp_core.palpation.perception.emg.levels import to_levels
from palp_core.palpation.perception.emg.peaks import PeakFinder
from palp_core.palpation.perception.strategy.figure5 import LEVELS
from palp_core.palpation.studies.perception.emg_known import (
    CONDITIONS,
    EmgCondition,
    Score,
    contractions,
    coverage,
    judge,
    recorded,
)
from palp_core.palpation.studies.perception.emg_models import MODELS

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


def wilson(hits: int, of: int) -> tuple[float, float]:
    """Return the 95 % interval of a share."""
    z, share = 1.96, hits / of
    middle, half = share + z * z / (2 * of), z * math.sqrt(share * (1 - share) / of + z * z / (4 * of * of))
    return (middle - half) / (1 + z * z / of), (middle + half) / (1 + z * z / of)


def row_of(model: str, name: str, one: Score) -> dict[str, Any]:
    """Return a line of the table."""
    low, high = wilson(one.right, one.made)
    return {
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


def before(window_s: float, distance_s: float, model: str, subjects: int, count: int) -> Score:
    """Return what peaks by prominence, held against the sum of maxima, make of the plain condition."""
    settings, of = EmgSettings(window_s=window_s, mvc_rule="sum_of_maxima"), EmgCondition("plain")
    made_count = found = extra = right = 0
    ratios: list[float] = []
    for one in range(subjects):
        rng = np.random.default_rng((SEED + one, 15))
        strength, made = contractions(of, count, rng)
        trial, mvc, _ = recorded(model, of, strength, rng)
        peaks = PeakFinder(of.rate_hz, distance_s=distance_s).whole(
            analyse(trial, mvc, settings).cocontraction
        )
        for each in made:
            inside = [p.value for p in peaks if each.begin <= p.index < each.end + 0.2 * of.rate_hz]
            found += len(inside) == 1
            extra += max(0, len(inside) - 1)
            if inside:
                ratios.append(max(inside) / each.level)
                level = LEVELS[int(to_levels(np.array([max(inside)])).index[0])]
                right += len(inside) == 1 and level == each.level
        made_count += len(made)
    return Score(made_count, found, extra, right, float(np.mean(ratios)) - 1.0)


def sustained(model: str, subjects: int) -> dict[str, Any]:
    """Return the bursts and peaks that contractions held for half a minute are taken for."""
    of = EmgCondition("held for 30 s", held_s=(30.0, 30.0), rest_s=(2.0, 2.0))
    bursts, peaks = [], []
    for one in range(subjects):
        rng = np.random.default_rng((SEED + one, 17))
        trial, mvc, rest = recorded(model, of, contractions(of, 2, rng)[0], rng)
        found = analyse(trial, mvc, EmgSettings(), rest=rest)
        bursts.append(len(found.bursts) / 2)
        peaks.append(len(found.peaks) / 2)
    return {"model": model, "bursts": float(np.mean(bursts)), "peaks": float(np.mean(peaks))}


def measure(job: tuple[str, argparse.Namespace]) -> dict[str, Any]:
    """Return every table of one model."""
    model, options = job
    size: dict[str, int] = {"subjects": options.subjects, "count": options.count, "seed": SEED}
    known = [
        row_of(model, of.name, judge(model, of, settings=EmgSettings(rate_hz=of.rate_hz), **size))
        for of in CONDITIONS
    ]
    rules = [
        row_of(model, name, judge(model, CONDITIONS[0], settings=replace(EmgSettings(), **changed), **size))
        for name, changed in RULES.items()
    ]
    for name, (window_s, distance_s) in BEFORE.items():
        one = before(window_s, distance_s, model, options.subjects, options.count)
        rules.append(row_of(model, name, one))
    fits = []
    for relax_share in (0.9, 0.5):
        seen = [
            coverage(model, EmgSettings(), seed=SEED + number, relax_share=relax_share)
            for number in range(options.fits)
        ]
        fits.append(
            {
                "model": model,
                "relax_share": relax_share,
                "entries_of_25": [one.entries for one in seen],
                "shares_of_5": [one.shares for one in seen],
                "transitions": [one.transitions for one in seen],
            }
        )
    return {"known": known, "rules": rules, "sustained": [sustained(model, options.subjects)], "fits": fits}


def line(row: dict[str, Any]) -> str:
    """Return a row as text."""
    low, high = row["levels_right_low"], row["levels_right_high"]
    return (
        f"{row['model']:<18} {row['condition']:<36} found {row['found']:6.1%}  false {row['false']:5.1%}  "
        f"levels right {row['levels_right']:6.1%} ({low:.1%} to {high:.1%})  bias {row['bias']:+.1%}"
    )


def draw(found: dict[str, Any], target: Path) -> None:
    """Draw what is wrong, by condition and model, beside the limits."""
    from matplotlib.figure import Figure

    names = [of.name for of in CONDITIONS]
    figure = Figure(figsize=(11.0, 5.5), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    wrong = (
        ("bursts not found, %", "found", 1.0),
        ("false bursts, %", "false", 1.0),
        ("levels wrong, %", "levels_right", 2.0),
    )
    for axes, (title, key, limit) in zip(panels, wrong, strict=True):
        for offset, (model, colour) in enumerate(zip(MODELS, ("#9db8d2", "#5b7fa6", "#d55e00"), strict=True)):
            rows = [row for row in found["known"] if row["model"] == model]
            values = [100.0 * (row[key] if key == "false" else 1.0 - row[key]) for row in rows]
            axes.plot(
                values,
                np.arange(len(names)) + 0.2 * (offset - 1),
                "o",
                color=colour,
                label=model,
                markersize=5,
            )
        axes.axvline(limit, color="grey", linestyle="--", linewidth=1.0)
        axes.set_xscale("symlog", linthresh=1.0)
        axes.set_xlim(-0.1, 100.0)
        axes.set_title(title, fontsize=10)
        axes.grid(axis="y", color="0.9")
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_yticks(range(len(names)), names)
    panels[0].invert_yaxis()
    panels[2].legend(fontsize=8)
    figure.savefig(target, dpi=130)


def main() -> None:
    """Measure, print, and write JSON, CSV and a chart."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("results/emg_bursts"))
    parser.add_argument("--subjects", type=int, default=15, help="each with an MVC of its own")
    parser.add_argument("--count", type=int, default=40, help="contractions of each")
    parser.add_argument("--fits", type=int, default=10, help="strategies learnt, of 15 trials each")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="2 subjects of 10, 1 fit")
    options = parser.parse_args()
    if options.quick:
        options.subjects, options.count, options.fits = 2, 10, 1
    found: dict[str, Any] = {"known": [], "rules": [], "sustained": [], "fits": []}
    with ProcessPoolExecutor(options.workers) as pool:
        for one in pool.map(measure, [(model, options) for model in MODELS]):
            for name, rows in one.items():
                found[name] += rows
            print(
                *map(line, one["known"] + one["rules"]), *one["sustained"], *one["fits"], sep="\n", flush=True
            )
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "emg_bursts.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    with (options.out / "emg_bursts.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, list(found["known"][0]), lineterminator="\n")
        table.writeheader()
        table.writerows(
            {key: f"{value:.4f}" if isinstance(value, float) else value for key, value in row.items()}
            for row in found["known"] + found["rules"]
        )
    draw(found, options.out / "emg_bursts.png")


if __name__ == "__main__":
    main()
