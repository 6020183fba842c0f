"""The paper's question, asked of every policy in the simulated rig.

One session a policy and seed: its own training, its own mounting of the phantoms, then estimation. Policies
share seeds. With several sessions, intervals are over sessions, which is what an interval ought to be over.

Run: .venv/bin/python benchmarks/policies.py [--out DIR] [--sessions 1] [--trials 100] [--training 25]
         [--policies fixed_16,markov] [shared.rehome:=palpation shared.height_sd_mm:=0.0 ...]
"""

from __future__ import annotations

import argparse
import json
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import msgspec
import numpy as np
from scipy.stats import t as student_t

from palp_core.graph.launch.graph import Graph
from palp_core.palpation.session.result import read_result

LAUNCH = Path(__file__).parents[1] / "launch" / "sim.yaml"
FIXED_MM = (0.0, 4.0, 8.0, 12.0, 16.0)
POLICIES = {
    **{f"fixed_{mm:g}": ["policy:=fixed", f"policy.ring_mm:={mm}"] for mm in FIXED_MM},
    "markov": ["policy:=markov"],
    "uniform": ["policy:=uniform"],
}


def run(job: tuple[Path, dict[str, Any], list[str]]) -> dict[str, Any]:
    """Run one session composed and return its result."""
    out, arguments, overrides = job
    with Graph(LAUNCH, compose=True, overrides=overrides, out=str(out), **arguments) as graph:
        graph.run()
    return dict(msgspec.to_builtins(read_result(out)))


def over_sessions(values: list[float]) -> dict[str, Any]:
    """Return the mean over sessions with Student's 95 % interval, clipped to 0 .. 1; none for one session."""
    count, mean = len(values), float(np.mean(values))
    if count < 2:
        return {"value": mean, "ci": None, "sessions": count}
    half = float(student_t.ppf(0.975, count - 1) * np.std(values, ddof=1) / np.sqrt(count))
    return {"value": mean, "ci": [max(0.0, mean - half), min(1.0, mean + half)], "sessions": count}


def summarise(results: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    """Return accuracy, depths, probes and calibration per policy over its sessions."""
    table: dict[str, Any] = {}
    for name, sessions in results.items():
        depths = sessions[0]["accuracy"]["per_depth_mm"]
        table[name] = {
            "accuracy": over_sessions([s["accuracy"]["overall"]["value"] for s in sessions]),
            "per_depth_mm": {
                d: over_sessions([s["accuracy"]["per_depth_mm"][d]["value"] for s in sessions])
                for d in depths
            },
            "probes_mean": float(np.mean([s["probes_mean"] for s in sessions])),
            "calibration_error": float(np.mean([s["calibration"]["expected_error"] for s in sessions])),
            "overconfidence": float(np.mean([s["calibration"]["overconfidence"] for s in sessions])),
        }
    fixed = [name for name in table if name.startswith("fixed")]
    if not fixed:
        return {"policies": table}
    per_session = np.array([[s["accuracy"]["overall"]["value"] for s in results[name]] for name in fixed])
    best = max(fixed, key=lambda name: table[name]["accuracy"]["value"])
    return {
        "policies": table,
        "fixed_average": over_sessions(per_session.mean(axis=0).tolist()),
        "fixed_best": best,
    }


def _share(line: dict[str, Any]) -> str:
    interval = line["ci"]
    return f"{line['value']:.1%}" + (f" ({interval[0]:.1%} to {interval[1]:.1%})" if interval else "")


def main() -> None:
    """Run the sessions, print the tables, and write them as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/policies"))
    parser.add_argument("--sessions", type=int, default=1, help="seeds 1 to this number")
    parser.add_argument("--trials", type=int, default=100, help="per phantom")
    parser.add_argument("--training", type=int, default=25, help="per phantom and ring position")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--policies", default=",".join(POLICIES), help="of these only")
    parser.add_argument("overrides", nargs="*", help="NAME:=VALUE, arguments of launch/sim.yaml")
    options = parser.parse_args()
    chosen = {name: POLICIES[name] for name in options.policies.split(",")}
    seeds = range(1, options.sessions + 1)
    common = {"trials": options.trials, "training": options.training}
    jobs = [
        (options.out / name / str(seed), {**common, "seed": seed}, [*own, *options.overrides])
        for name, own in chosen.items()
        for seed in seeds
    ]
    results: dict[str, list[dict[str, Any]]] = {name: [] for name in chosen}
    with ProcessPoolExecutor(options.workers) as pool:
        for (out, *_), result in zip(jobs, pool.map(run, jobs), strict=True):
            results[out.parent.name].append(result)
            print(f"{out.parent.name} {out.name}: {result['accuracy']['overall']['value']:.1%}", flush=True)
    summary = summarise(results)
    (options.out / "policies.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    print(f"{'policy':<14} accuracy; by depth; palpations a trial; calibration error; over-confidence")
    for name, row in summary["policies"].items():
        depths = ", ".join(f"{d} mm {_share(one)}" for d, one in row["per_depth_mm"].items())
        rest = f"{row['probes_mean']:.1f}; {row['calibration_error']:.3f}; {row['overconfidence']:+.3f}"
        print(f"{name:<14} {_share(row['accuracy'])}; {depths}; {rest}")
    if chosen == POLICIES:
        print(f"{'fixed_average':<14} {_share(summary['fixed_average'])}")
        print(f"best fixed: {summary['fixed_best']}")


if __name__ == "__main__":
    main()
