"""How fast the simulated rig runs, and where the time goes.

Seconds of sweep per wall second (leaps over idle time do not count), composed and as processes, in
interleaved rounds; the limit they are measured against is the nodes' own work with no graph around it: what
the profile finds in nodes, devices, mechanics, perception and the record.

Run: .venv/bin/python benchmarks/sim_speed.py [--quick] [--json]
"""

from __future__ import annotations

import argparse
import cProfile
import json
import os
import pstats
import statistics
import tempfile
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from palp_core.graph.launch.graph import Graph
from palp_core.palpation.session.result_json import read_result

LAUNCH = Path(__file__).parents[1] / "launch" / "sim.yaml"
PLACES = (
    ("record", ("session/trials_csv.py", "zipfile", "npyio", "compress", "posix.")),
    ("mechanics", ("palpation/mechanics", "interpolate")),
    ("perception", ("palpation/perception", "pywt", "_dwt", "_signaltools", "_peak_finding")),
    ("devices", ("palpation/devices",)),
    ("nodes", ("/nodes/",)),
    ("messages", ("graph/messages", "msgspec")),
    ("runtime", ("graph/node", "graph/process", "graph/transport", "zmq")),
    ("conductor", ("graph/lockstep", "graph/launch")),
)


def run(folder: Path, *, compose: bool, trials: int, training: int) -> dict[str, Any]:
    """Run one session and return its result."""
    with Graph(
        LAUNCH, compose=compose, out=str(folder), overwrite=True, trials=trials, training=training
    ) as graph:
        graph.run()
    return read_result(folder)


def profile(folder: Path, *, trials: int, training: int) -> dict[str, float]:
    """Return the share of each place in the composed run's own time; the rest is numpy and Python itself."""
    profiler = cProfile.Profile()
    with Graph(LAUNCH, compose=True, out=str(folder), trials=trials, training=training) as graph:
        profiler.enable()
        graph.run(until_s=1e9)  # a run to a time writes no report
        profiler.disable()
    shares = dict.fromkeys([name for name, _ in PLACES] + ["numpy and python"], 0.0)
    total = 0.0
    for (file, _, function), (_, _, own_s, _, _) in pstats.Stats(profiler).stats.items():  # type: ignore[attr-defined]
        where = f"{file}/{function}"
        place = next((n for n, words in PLACES if any(w in where for w in words)), "numpy and python")
        shares[place] += own_s
        total += own_s
    return {name: own_s / total for name, own_s in shares.items()}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one round of a short session")
    parser.add_argument("--json", action="store_true", help="one object for machines")
    options = parser.parse_args()
    rounds, size = (1, {"trials": 5, "training": 3}) if options.quick else (3, {"trials": 20, "training": 10})
    found: dict[str, list[dict[str, Any]]] = {"composed": [], "processes": []}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(rounds):
            for name in found:
                found[name].append(run(Path(folder) / "out", compose=name == "composed", **size))
        shares = profile(Path(folder) / "profile", **size)
    result: dict[str, Any] = {}
    for name, results in found.items():
        result[name] = {
            key: statistics.median(r[key] for r in results)
            for key in ("sweep_s_per_wall_s", "palpations_per_wall_s", "wall_time_s")
        }
    result["processes_over_composed"] = (
        result["processes"]["sweep_s_per_wall_s"] / result["composed"]["sweep_s_per_wall_s"]
    )
    result["profile_composed"] = shares
    if options.json:
        print(json.dumps(result))
        return
    for name in found:
        figures = result[name]
        print(
            f"{name}: {figures['sweep_s_per_wall_s']:.0f} s of sweep per wall second, "
            f"{figures['palpations_per_wall_s']:.0f} palpations per second"
        )
    print("where the composed run's time goes:")
    for name, share in sorted(shares.items(), key=lambda item: -item[1]):
        print(f"  {name:<18} {share:.0%}")


if __name__ == "__main__":
    main()
