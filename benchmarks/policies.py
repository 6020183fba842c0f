"""The paper's question, asked of every policy: one full session each, from the same seed, as one table.

Run: .venv/bin/python benchmarks/policies.py [--out DIR] [--seed 1] [--trials 100] [--training 25]
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from palp_core.launch.graph import Graph
from palp_core.studies.compare import compare
from palp_core.studies.result import read_result

LAUNCH = Path(__file__).parents[1] / "launch" / "sim.yaml"
FIXED_MM = (0.0, 4.0, 8.0, 12.0, 16.0)


def run(out: Path, **arguments: Any) -> dict[str, Any]:
    """Run one session composed and return its result."""
    with Graph(LAUNCH, compose=True, out=str(out), **arguments) as graph:
        graph.run()
    return read_result(out)


def main() -> None:
    """Run the sessions and print the table; JSON beside it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/policies"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--training", type=int, default=25)
    options = parser.parse_args()
    common = {"seed": options.seed, "trials": options.trials, "training": options.training}
    sessions: dict[str, dict[str, Any]] = {
        f"fixed_{mm:g}": {"policy": "fixed", "ring_mm": mm} for mm in FIXED_MM
    }
    sessions |= {"markov": {"policy": "markov"}, "uniform": {"policy": "uniform"}}
    results = {}
    for name, arguments in sessions.items():
        results[name] = run(options.out / name, **arguments, **common)
        accuracy = results[name]["accuracy"]["overall"]["value"]
        speed = results[name]["sweep_s_per_wall_s"]
        print(f"{name}: {accuracy:.1%}, {speed:.0f} s of sweep per s", flush=True)
    shares = {name: result["accuracy"]["overall"]["value"] for name, result in results.items()}
    fixed = {name: share for name, share in shares.items() if name.startswith("fixed")}
    summary = {
        "fixed_average": sum(fixed.values()) / len(fixed),
        "fixed_best": max(fixed, key=lambda name: fixed[name]),
        "accuracy": {name: result["accuracy"] for name, result in results.items()},
        "probes_mean": {name: result["probes_mean"] for name, result in results.items()},
        "wall_time_s": {name: result["wall_time_s"] for name, result in results.items()},
        "sweep_s_per_wall_s": {name: result["sweep_s_per_wall_s"] for name, result in results.items()},
    }
    (options.out / "policies.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    print(compare([options.out / name for name in sessions]))
    print(f"average of the fixed ones: {summary['fixed_average']:.1%}; best: {summary['fixed_best']}")


if __name__ == "__main__":
    main()
