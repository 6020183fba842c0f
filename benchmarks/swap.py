"""What a hot swap costs: messages lost, the gap, and how long the command takes, under a stream of 1 kHz.

The middle one of three nodes is swapped back and forth between two classes while numbers go through it. A
reader, a process of its own, keeps every number with its maker and the time at which that had it; afterwards
the file is checked: each number once and in order. The gap is the longest time, at a swap, between the last
number of one maker and the first of the other (the stream's own period of 1 ms is part of it); beside it
stands the pause that the runtime itself reports. The command's time is from the request to the old process's
end. Then come swaps whose new node does well on probation, and as many whose new node raises or dies after a
hundred numbers: the gap before its first number is that of the change of hands, the one after its last that
of the return to the old node.

``--storm N`` swaps N times and kills or stops a process each time, at a step or instant drawn by ``--seed``:
see :mod:`swap_bench.storm`. ``--busy`` keeps so many cores busy meanwhile. A turn that went wrong leaves its
tapes and logs in the folder of ``--out``, and is repeated by ``--storm 1 --first ITS_NUMBER``.

Run: .venv/bin/python benchmarks/swap.py [--quick] [--json] [--swaps N] [--faults N] [--probations N]
     .venv/bin/python benchmarks/swap.py --storm 300 --busy 2 [--seed S] [--first K] [--json] [--out DIR]
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.graph.discovery.running_graph import RunningGraph

HERE = Path(__file__).parent / "swap_bench"
BETWEEN_S = 0.05
FAILING = 3  # the mark of those that fail on probation


def measure(swaps: int, faults: int, probations: int, folder: Path) -> dict[str, Any]:
    """Swap so often, so often with a fault, so often on probation; return what came, and how long it took."""
    rows = folder / "rows.npy"
    launch = [sys.executable, "-m", "palp_core", "launch", str(HERE / "launch/stream.yaml"), f"out:={rows}"]
    process = subprocess.Popen(launch, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        if not any(line.startswith("stream:") for line in process.stdout):
            raise SystemExit("the graph did not come up; its output is above")
        graph = RunningGraph.find("swap_bench")
        reports, command_s = [], []
        for turn in range(swaps):
            threading.Event().wait(BETWEEN_S)  # nothing comes: a rest between two swaps
            begun_ns = time.monotonic_ns()
            answer = graph.swap("relay", f"nodes.stream:{('Second', 'First')[turn % 2]}")
            command_s.append((time.monotonic_ns() - begun_ns) / 1e9)
            reports.append(answer["report"])
        chance, taken_back = random.Random(0), 0
        for _ in range(faults):
            run = chance.choice(("Dies", "Misfit", "Missing"))
            taken_back += "failed" in graph.swap("relay", f"nodes.stream:{run}")
        proven_s, returned = [], 0
        for turn in range(probations):
            wanted = {"run_count": 3, "longest_s": 3.0}
            answer = graph.swap("relay", f"nodes.stream:{('Second', 'First')[turn % 2]}", probation=wanted)
            proven_s.append(answer["report"]["gap_s"])
            wanted = {"run_count": 100_000, "longest_s": 60.0}
            failing = f"nodes.stream:{('Raises', 'Falls')[turn // 2 % 2]}"
            answer = graph.swap("relay", failing, probation=wanted)
            returned += answer["failed"]["step"] == "probation"
        account = graph.ask("reader", "info")["inputs"]["/relay/out"]
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()
    got = np.load(rows)
    return {
        "swaps": swaps,
        "faults": faults,
        "taken_back": taken_back,
        **judged(got),
        "reader_lost": account["lost"],
        "reader_repeated": account["repeated"],
        **percentiles("pause", [report["gap_s"] * 1e3 for report in reports]),
        **percentiles("command", [s * 1e3 for s in command_s]),
        "probations": 2 * probations,
        "returned": returned,
        **percentiles("probation_pause", [s * 1e3 for s in proven_s]),
        "held_max": max((report["held"] for report in reports), default=0),
    }


def judged(rows: np.ndarray[Any, Any]) -> dict[str, Any]:
    """Return what was lost, repeated and out of order, and the gaps where the maker changes."""
    index, maker, handled_ns = rows.T
    changes = np.flatnonzero(np.diff(maker))
    gaps_ms = (handled_ns[changes + 1] - handled_ns[changes]) / 1e6
    failing = maker[changes] == FAILING
    return {
        "received": len(index),
        "lost": int(index.max() - index.min() + 1 - len(np.unique(index))),
        "repeated": int(len(index) - len(np.unique(index))),
        "reordered": int(np.count_nonzero(np.diff(index) < 0)),
        "changes": len(changes),
        **percentiles("gap", gaps_ms[~failing].tolist()),
        **percentiles("return", gaps_ms[failing].tolist()),
    }


def percentiles(name: str, values_ms: list[float]) -> dict[str, float]:
    """Return median, 99th percentile and maximum by name."""
    if not values_ms:
        return {}
    p50, p99, most = np.percentile(values_ms, (50, 99, 100))
    return {f"{name}_p50_ms": float(p50), f"{name}_p99_ms": float(p99), f"{name}_max_ms": float(most)}


def storm(given: argparse.Namespace) -> int:
    """Swap under faults; return 1 if anything was not as promised."""
    from swap_bench.storm import Turn, run_storm

    def report(turn: Turn) -> None:
        fault = f"{turn.plan.fault}, {turn.plan.step or 'instant'}"
        print(
            "; ".join([f"{turn.number}: {fault}: {turn.outcome} {turn.text}", *turn.wrong]), file=sys.stderr
        )

    out = given.out or Path("storm")
    found = run_storm(given.storm, given.seed, first=given.first, burning=given.busy, folder=out, show=report)
    if given.json:
        print(json.dumps(found))
    else:
        for fault, row in found["by_fault"].items():
            print(f"{fault:15} {json.dumps(row)}")
        print(f"{len(found['failures'])} of {found['turns']} turns not as promised; see {out / 'storm.json'}")
    return int(bool(found["failures"]))


def main() -> None:
    """Measure and say what came out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument(
        "--quick", action="store_true", help="30 swaps, 6 faults and 4 probations, within 60 s"
    )
    parser.add_argument("--json", action="store_true", help="for machines")
    parser.add_argument("--swaps", type=int)
    parser.add_argument("--faults", type=int)
    parser.add_argument("--probations", type=int)
    parser.add_argument("--out", type=Path, help="folder of storm.json (default: storm)")
    parser.add_argument("--storm", type=int, metavar="N", help="swap so often, with a fault each time")
    parser.add_argument("--seed", type=int, default=1, help="of the faults")
    parser.add_argument("--first", type=int, default=0, metavar="K", help="begin with this turn")
    parser.add_argument(
        "--busy", type=int, default=0, metavar="N", help="processes that compute all the time"
    )
    given = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if given.storm:
        sys.exit(storm(given))
    swaps = given.swaps if given.swaps is not None else 30 if given.quick else 200
    faults = given.faults if given.faults is not None else 6 if given.quick else 100
    probations = given.probations if given.probations is not None else 4 if given.quick else 100
    with tempfile.TemporaryDirectory(prefix="palp-swap-") as folder:
        found = measure(swaps, faults, probations, Path(folder))
    if given.json:
        print(json.dumps(found))
    else:
        for name, value in found.items():
            print(f"{name:20} {value:.2f}" if isinstance(value, float) else f"{name:20} {value}")


if __name__ == "__main__":
    main()
