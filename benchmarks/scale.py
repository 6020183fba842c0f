"""What a graph costs against the number of its nodes: start, CPU, memory, descriptors, wake-ups, end.

Each node publishes ``--rate`` times a second and reads its neighbour, in a ring: with 10, twenty messages a
second. Of each size, in interleaved rounds: from the command to the first message at every node
(``start_s``); then, over a window, the CPU of the launcher (with its fork server) and of a node in per cent
of a core, how often a node's process woke up a second, all its threads, the memory that belongs to a node
alone (PSS, so that what processes share is counted once), open descriptors; messages lost; and from Ctrl-C to
the last process's end (``end_s``). The slope is that of the launcher's CPU against the number of nodes, by
least squares.

Run: .venv/bin/python benchmarks/scale.py [--sizes 10,30,100,300] [--rounds N] [--window S] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from palp_core.errors import GraphError
from palp_core.graph.discovery.running_graph import RunningGraph

NODE = Path(__file__).parent / "scale_bench" / "nodes" / "beat.py"
PATIENCE_S = 600.0
RATE_HZ = 10.0
WORDS = {
    "start_s": "to the first message at every node, s",
    "launcher_cpu_percent": "launcher, % of a core",
    "node_cpu_percent": "a node, % of a core",
    "wakeups_per_s": "wake-ups of a node a second, for 20 messages",
    "memory_mib": "memory of all, MiB",
    "descriptors": "descriptors of a node",
    "launcher_descriptors": "descriptors of the launcher",
    "lost": "messages lost",
    "end_s": "to the end, s",
}


def launch_file(folder: Path, size: int) -> Path:
    """Write a launch file of a ring of nodes, and return it."""
    nodes = "".join(
        f'  n{at}: {{run: "{NODE}:Beater", params: {{rate_hz: {RATE_HZ}}}, '
        f"inputs: {{beat: n{(at - 1) % size}/out}}}}\n"
        for at in range(size)
    )
    file = folder / "launch" / f"ring{size}.yaml"
    file.parent.mkdir(exist_ok=True)
    file.write_text(f"graph: ring{size}\nclock: wall\nnodes:\n{nodes}", encoding="utf-8")
    return file


def measure(size: int, window_s: float, folder: Path) -> dict[str, float]:
    """Run a graph of that size for a window; return its figures."""
    begun_s = time.monotonic()
    command = [sys.executable, "-m", "palp_core", "launch", str(launch_file(folder, size))]
    with (folder / "output.txt").open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=output)
    try:
        graph: RunningGraph | None = None
        while graph is None or not all(node["received"] for node in edges(graph)):
            if process.poll() is not None or time.monotonic() > begun_s + PATIENCE_S:
                raise SystemExit((folder / "output.txt").read_text(encoding="utf-8"))
            try:
                graph = graph or RunningGraph.find(f"ring{size}")
            except GraphError:
                threading.Event().wait(0.02)
        start_s = time.monotonic() - begun_s
        figures = window(graph, process, window_s)
        lost = sum(edge["lost"] for edge in edges(graph))
        ending_s = time.monotonic()
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)
        return {"start_s": start_s, **figures, "lost": lost, "end_s": time.monotonic() - ending_s}
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def edges(graph: RunningGraph) -> list[dict[str, Any]]:
    """Return the account of every node's input."""
    names = [node.name for node in graph.record.nodes]
    return [edge for name in names for edge in graph.ask(name, "info", timeout_s=60)["inputs"].values()]


def window(graph: RunningGraph, process: subprocess.Popen[bytes], window_s: float) -> dict[str, float]:
    """Watch a graph for a while."""
    own = psutil.Process(process.pid)
    pids = {node.pid for node in graph.record.nodes}
    family = own.children(recursive=True)
    nodes = [child for child in family if child.pid in pids]
    launchers = [own, *(child for child in family if child.pid not in pids)]
    before = cpu_s(launchers), cpu_s(nodes), switches(nodes), time.monotonic()
    threading.Event().wait(window_s)
    after = cpu_s(launchers), cpu_s(nodes), switches(nodes), time.monotonic()
    launcher_s, node_s, woken, wall_s = (b - a for a, b in zip(before, after, strict=True))
    return {
        "launcher_cpu_percent": 100 * launcher_s / wall_s,
        "node_cpu_percent": 100 * node_s / wall_s / len(nodes),
        "wakeups_per_s": woken / wall_s / len(nodes),
        "memory_mib": sum(process.memory_full_info().pss for process in [*launchers, *nodes]) / 2**20,
        "descriptors": statistics.median(node.num_fds() for node in nodes),
        "launcher_descriptors": own.num_fds(),
    }


def cpu_s(processes: list[psutil.Process]) -> float:
    """Return the CPU time of processes."""
    return sum(sum(process.cpu_times()[:2]) for process in processes)


def switches(processes: list[psutil.Process]) -> int:
    """Return how often processes have gone to sleep, all their threads."""
    total = 0
    for process in processes:
        for thread in Path(f"/proc/{process.pid}/task").iterdir():
            for line in (thread / "status").read_text(encoding="utf-8").splitlines():
                if line.startswith("voluntary_ctxt_switches"):
                    total += int(line.split()[1])
    return total


def in_words(row: dict[str, float]) -> str:
    """Return median, least and largest, three digits of each."""
    median, least, most = (f"{float(f'{row[key]:.3g}'):g}" for key in ("median", "min", "max"))
    return median if least == most else f"{median} ({least} to {most})"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", default="10,30,100,300", help="numbers of nodes")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--window", type=float, default=10.0, help="seconds of each look")
    parser.add_argument("--json", action="store_true", help="one object for machines")
    options = parser.parse_args()
    sizes = [int(size) for size in options.sizes.split(",")]
    rows: dict[int, list[dict[str, float]]] = {size: [] for size in sizes}
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory(prefix="palp-scale-") as name:
        for number in range(options.rounds):
            for size in sizes:
                print(f"round {number + 1}: {size} nodes", file=sys.stderr, flush=True)
                rows[size].append(measure(size, options.window, Path(name)))
    found = {
        size: {
            key: {"median": statistics.median(values), "min": min(values), "max": max(values)}
            for key in of_size[0]
            if (values := [row[key] for row in of_size])
        }
        for size, of_size in rows.items()
    }
    slope, start = np.polyfit(sizes, [found[size]["launcher_cpu_percent"]["median"] for size in sizes], 1)
    if options.json:
        print(json.dumps({"rounds": options.rounds, "sizes": found, "launcher_cpu_per_node": float(slope)}))
        return
    print(f"| nodes | {' | '.join(map(str, sizes))} |\n|{'---|' * (1 + len(sizes))}")
    for key, words in WORDS.items():
        print(f"| {words} | {' | '.join(in_words(found[size][key]) for size in sizes)} |")
    print(f"the launcher: {start:.2f} % of a core, and {slope:.4f} % for each node")


if __name__ == "__main__":
    main()
