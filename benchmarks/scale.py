"""What a graph costs against the number of its nodes: start, CPU, memory, descriptors, wake-ups, end.

Each node says something ``--rate`` times a second and hears its neighbour, in a ring: with 10, twenty
messages a second. Of each size, in interleaved rounds: from the command to the first message at every node
(``start_s``); then, over a window, the CPU of the launcher (with its fork server) and of a node in per cent
of a core, how often a node's process woke up a second, all its threads, and for each message (two is the
least with ZeroMQ: its own thread sends and receives, and the node works), the memory that belongs to a node
alone (PSS, so that what processes share is counted once), open descriptors; messages lost; and from Ctrl-C to
the last process's end (``end_s``). The slope is that of the launcher's CPU against the number of nodes, by
least squares.

Run: .venv/bin/python benchmarks/scale.py [--sizes 10,30,100,300] [--rounds N] [--window S] [--rate R]
         [--json] [--chart FILE.png] [--quick]
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
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress as Bar
from rich.table import Table

from palp_core.errors import GraphError
from palp_core.graph.discovery.running_graph import RunningGraph

NODE = Path(__file__).parent / "scale_bench" / "nodes" / "beat.py"
PATIENCE_S = 600.0
COLUMNS = {
    "start_s": "start [s]",
    "launcher_cpu": "launcher [% of a core]",
    "node_cpu": "node [% of a core]",
    "wakeups_per_s": "wake-ups of a node [1/s]",
    "wakeups_per_message": "wake-ups for each message",
    "memory_mib": "all memory [MiB]",
    "descriptors": "descriptors of a node",
    "launcher_descriptors": "descriptors of the launcher",
    "lost": "lost",
    "end_s": "end [s]",
}


def launch_file(folder: Path, size: int, rate_hz: float) -> Path:
    """Write a launch file of a ring of nodes, and return it."""
    nodes = "".join(
        f'  n{at}: {{run: "{NODE}:Beater", params: {{rate_hz: {rate_hz}}}, '
        f"inputs: {{beat: n{(at - 1) % size}/out}}}}\n"
        for at in range(size)
    )
    file = folder / "launch" / f"ring{size}.yaml"
    file.parent.mkdir(exist_ok=True)
    file.write_text(f"graph: ring{size}\nclock: wall\nnodes:\n{nodes}", encoding="utf-8")
    return file


def pause(seconds: float) -> None:
    """Let time go by."""
    threading.Event().wait(seconds)


def graph_of(name: str, process: subprocess.Popen[bytes], end_s: float) -> RunningGraph:
    """Wait for a graph and return it.

    Raises:
        SystemExit: It does not come up.
    """
    while time.monotonic() < end_s and process.poll() is None:
        try:
            return RunningGraph.find(name)
        except GraphError:
            pause(0.02)
    raise SystemExit(f"{name} did not come up")


def cpu_s(processes: list[psutil.Process]) -> float:
    """Return the CPU time of processes."""
    return sum(sum(one.cpu_times()[:2]) for one in processes)


def pss_mib(process: psutil.Process) -> float:
    """Return a process's own memory and its part of what it shares."""
    for line in Path(f"/proc/{process.pid}/smaps_rollup").read_text(encoding="utf-8").splitlines():
        if line.startswith("Pss:"):
            return int(line.split()[1]) / 1024
    return float("nan")


def measure(size: int, window_s: float, rate_hz: float, folder: Path) -> dict[str, float]:
    """Run a graph of that size for a window; return its figures."""
    begun_s = time.monotonic()
    command = [sys.executable, "-m", "palp_core", "launch", str(launch_file(folder, size, rate_hz))]
    with (folder / "said.txt").open("wb") as said:
        process = subprocess.Popen(command, stdout=said, stderr=said)
    try:
        graph = graph_of(f"ring{size}", process, begun_s + PATIENCE_S)
        names = [node.name for node in graph.record.nodes]
        waiting = set(names)
        while waiting:
            waiting = {name for name in waiting if not heard(graph, name)}
            if process.poll() is not None or time.monotonic() > begun_s + PATIENCE_S:
                raise SystemExit((folder / "said.txt").read_text(encoding="utf-8"))
        start_s = time.monotonic() - begun_s
        figures = window(graph, process, window_s)
        figures["wakeups_per_message"] = figures["wakeups_per_s"] / (2.0 * rate_hz)
        lost = sum(
            edge["lost"]
            for name in names
            for edge in graph.ask(name, "info", timeout_s=60)["inputs"].values()
        )
        ending_s = time.monotonic()
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)
        return {"start_s": start_s, **figures, "lost": lost, "end_s": time.monotonic() - ending_s}
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def heard(graph: RunningGraph, name: str) -> bool:
    """Tell whether a node has heard its neighbour."""
    inputs = graph.ask(name, "info", timeout_s=60)["inputs"]
    return all(edge["received"] for edge in inputs.values())


def window(graph: RunningGraph, process: subprocess.Popen[bytes], window_s: float) -> dict[str, float]:
    """Look at a graph for a while."""
    own = psutil.Process(process.pid)
    pids = {node.pid for node in graph.record.nodes}
    family = own.children(recursive=True)
    nodes = [one for one in family if one.pid in pids]
    launchers = [own, *(one for one in family if one.pid not in pids)]
    before = cpu_s(launchers), cpu_s(nodes), switches(nodes), time.monotonic()
    pause(window_s)
    after = cpu_s(launchers), cpu_s(nodes), switches(nodes), time.monotonic()
    launcher_s, node_s, woken, wall_s = (b - a for a, b in zip(before, after, strict=True))
    return {
        "launcher_cpu": 100 * launcher_s / wall_s,
        "node_cpu": 100 * node_s / wall_s / len(nodes),
        "wakeups_per_s": woken / wall_s / len(nodes),
        "memory_mib": sum(pss_mib(one) for one in [*launchers, *nodes]),
        "descriptors": statistics.median(one.num_fds() for one in nodes),
        "launcher_descriptors": own.num_fds(),
    }


def switches(processes: list[psutil.Process]) -> int:
    """Return how often processes have gone to sleep, all their threads."""
    total = 0
    for one in processes:
        for thread in Path(f"/proc/{one.pid}/task").iterdir():
            for line in (thread / "status").read_text(encoding="utf-8").splitlines():
                if line.startswith("voluntary_ctxt_switches"):
                    total += int(line.split()[1])
    return total


def chart(found: dict[str, Any], file: Path) -> None:
    """Draw each figure against the number of nodes."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    shown = ("start_s", "launcher_cpu", "node_cpu", "memory_mib", "launcher_descriptors", "end_s")
    sizes = [int(size) for size in found["sizes"]]
    figure, axes = plt.subplots(2, 3, figsize=(9, 5), layout="constrained")
    for axis, name in zip(axes.flat, shown, strict=True):
        rows = [found["sizes"][str(size)][name] for size in sizes]
        axis.plot(sizes, [row["median"] for row in rows], "o-", color="#1f5a96")
        axis.fill_between(
            sizes,
            [row["min"] for row in rows],
            [row["max"] for row in rows],
            color="#1f5a96",
            alpha=0.2,
            lw=0,
        )
        axis.set(xlabel="nodes", ylabel=COLUMNS[name], xlim=(0, None), ylim=(0, None))
    figure.savefig(file, dpi=110)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", default="10,30,100,300", help="numbers of nodes")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--window", type=float, default=10.0, help="seconds of each look")
    parser.add_argument("--rate", type=float, default=10.0, help="messages a second that each node says")
    parser.add_argument("--quick", action="store_true", help="one round of 4 and 8 nodes, two seconds each")
    parser.add_argument("--json", action="store_true", help="one object for machines")
    parser.add_argument("--chart", type=Path, help="write the picture here")
    options = parser.parse_args()
    if options.quick:
        options.sizes, options.rounds, options.window = "4,8", 1, 2.0
    sizes = [int(size) for size in options.sizes.split(",")]
    rows: dict[int, list[dict[str, float]]] = {size: [] for size in sizes}
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with (
        tempfile.TemporaryDirectory(prefix="palp-scale-") as name,
        Bar(console=Console(stderr=True), transient=True) as bar,
    ):
        task = bar.add_task("graphs", total=len(sizes) * options.rounds)
        for _ in range(options.rounds):
            for size in sizes:
                rows[size].append(measure(size, options.window, options.rate, Path(name)))
                bar.advance(task)
    found: dict[str, Any] = {
        "rounds": options.rounds,
        "sizes": {
            str(size): {
                key: {
                    "median": statistics.median(values := [row[key] for row in rows[size]]),
                    "min": min(values),
                    "max": max(values),
                }
                for key in COLUMNS
            }
            for size in sizes
        },
    }
    slope, start = np.polyfit(
        sizes, [found["sizes"][str(size)]["launcher_cpu"]["median"] for size in sizes], 1
    )
    found["launcher_cpu_per_node"], found["launcher_cpu_of_none"] = float(slope), float(start)
    if options.chart is not None:
        chart(found, options.chart)
    if options.json:
        print(json.dumps(found))
        return
    table = Table("", *(f"{size} nodes" for size in sizes))
    for key, title in COLUMNS.items():
        figures = [found["sizes"][str(size)][key] for size in sizes]
        table.add_row(
            escape(title), *(f"{row['median']:.3g} ({row['min']:.3g} to {row['max']:.3g})" for row in figures)
        )
    Console(width=40 + 30 * len(sizes)).print(table)
    print(f"the launcher: {start:.2f} % of a core, and {slope:.4f} % for each node")


if __name__ == "__main__":
    main()
