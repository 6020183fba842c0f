"""How fast the simulated rig runs, and where the time goes.

Seconds of sweep per wall second (leaps over idle time do not count), composed and as processes, in
interleaved rounds; the limit they are measured against is the nodes' own work with no graph around it: what
the profile finds in nodes, devices, mechanics, perception and the record.

With ``--blocks`` instead: CPU time of a palpation against the length of the blocks in which torque travels,
seven rounds of some 160 palpations of each length.

Run: .venv/bin/python benchmarks/sim_speed.py [--quick] [--rounds N] [--json] [--blocks [--chart FILE.png]]
"""

from __future__ import annotations

import argparse
import cProfile
import json
import os
import pstats
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from palp_core.graph.launch.graph import Graph
from palp_core.palpation.session.result import SessionResult, read_result

LAUNCH = Path(__file__).parents[1] / "launch" / "sim.yaml"
SWEEP_S = 4.0
"""Of the launch file: 80 mm at 20 mm/s."""

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


def run(folder: Path, *, compose: bool, trials: int, training: int) -> SessionResult:
    """Run one session and return its result."""
    with Graph(
        LAUNCH, compose=compose, out=str(folder), overwrite=True, trials=trials, training=training
    ) as graph:
        graph.run()
    return read_result(folder)


BLOCKS = (10, 20, 50, 100, 200, 500, 1000)
"""Samples of a block, at 1 kHz: milliseconds."""


def cpu_of_a_palpation(folder: Path, samples: int, *, trials: int, training: int) -> float:
    """Return the CPU time of a palpation in a composed session without its start and report, in ms."""
    count = 0

    def observe(_: int, frame: bytes) -> None:
        nonlocal count
        count += frame.startswith(b"/estimator/palpation\0")

    arguments: dict[str, Any] = {
        "out": str(folder),
        "overwrite": True,
        "trials": trials,
        "training": training,
    }
    with Graph(LAUNCH, compose=True, observe=observe, block_samples=samples, **arguments) as graph:
        begun_s = time.process_time()
        graph.run(until_s=1e9)  # a run to a time writes no report
        return 1e3 * (time.process_time() - begun_s) / count


def by_block(folder: Path, rounds: int, size: dict[str, int]) -> dict[int, list[float]]:
    """Return the CPU time of a palpation, in ms, for each length of blocks, in interleaved rounds."""
    found: dict[int, list[float]] = {samples: [] for samples in BLOCKS}
    for _ in range(rounds):
        for samples in BLOCKS:
            found[samples].append(cpu_of_a_palpation(folder / "blocks", samples, **size))
    return found


def print_blocks(found: dict[int, list[float]], chart: Path | None) -> None:
    """Print the table, and draw it if a file is named."""
    print("block, ms   CPU of a palpation, ms (least to most)   seconds of sweep per second of CPU")
    for samples, spent_ms in found.items():
        median_ms = statistics.median(spent_ms)
        spread = f"({min(spent_ms):.2f} to {max(spent_ms):.2f})"
        print(f"{samples:>9}   {median_ms:>8.2f} {spread:<33} {SWEEP_S / median_ms * 1e3:>8.0f}")
    if chart is None:
        return
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 3.2), layout="constrained")
    axes = figure.subplots()
    lengths = list(found)
    axes.plot(
        lengths, [SWEEP_S * 1e3 / statistics.median(ms) for ms in found.values()], "o-", color="#0072b2"
    )
    least, most = ([SWEEP_S * 1e3 / of(ms) for ms in found.values()] for of in (max, min))
    axes.fill_between(lengths, least, most, color="#0072b2", alpha=0.2, lw=0)
    axes.set_xscale("log")
    axes.set_xticks(lengths, [f"{length}" for length in lengths])
    axes.minorticks_off()
    axes.set(xlabel="block, ms", ylabel="seconds of sweep per second of CPU", ylim=(0, None))
    axes.grid(True, alpha=0.3)
    figure.savefig(chart, dpi=110)


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
    parser.add_argument("--rounds", type=int, help="3; of --blocks 7")
    parser.add_argument("--json", action="store_true", help="one object for machines")
    parser.add_argument(
        "--blocks", action="store_true", help="CPU of a palpation against the length of blocks"
    )
    parser.add_argument("--chart", type=Path, help="draw --blocks into this PNG")
    options = parser.parse_args()
    if options.blocks:
        count, few = (
            (1, {"trials": 2, "training": 2})
            if options.quick
            else (options.rounds or 7, {"trials": 6, "training": 6})
        )
        with tempfile.TemporaryDirectory() as folder:
            table = by_block(Path(folder), count, few)
        print(json.dumps(table)) if options.json else print_blocks(table, options.chart)
        return
    rounds, size = (
        (1, {"trials": 5, "training": 3})
        if options.quick
        else (options.rounds or 3, {"trials": 20, "training": 10})
    )
    found: dict[str, list[SessionResult]] = {"composed": [], "processes": []}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(rounds):
            for name in found:
                found[name].append(run(Path(folder) / "out", compose=name == "composed", **size))
        shares = profile(Path(folder) / "profile", **size)
    result: dict[str, Any] = {}
    for name, results in found.items():
        result[name] = {
            key: statistics.median(getattr(r, key) for r in results)
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
