"""What ``palp bridge ros2`` adds: torque at 1 kHz both ways, beside bare rclpy in the same rounds.

``bare`` is rclpy to rclpy over Fast DDS, one process per end; ``out`` a node of a graph, the bridge, an
rclpy reader; ``in`` an rclpy writer, the bridge, an external port of a graph. All carry a WrenchStamped,
reliably, on this host's loopback, and stamp it just before it is published and as soon as the reader's
handler has it, on the host's monotonic clock; each goes one way, and nothing else is sent then. The order
turns from round to round; stated are p50 and p99 of each, median over rounds with the least and the largest,
the ratio to ``bare`` within a round, and what was lost. The machine should be otherwise idle. Needs
``pip install 'palp-core[ros2]'``.

Run: .venv/bin/python benchmarks/ros2_bridge.py [--rounds 7] [--seconds 10] [--rate 1000] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

HERE = Path(__file__).resolve().parent / "ros2_bench"
SOURCE = HERE.parents[1] / "src"
DOMAIN = "87"
PATIENCE_S = 120.0
SILENT_HZ = 0.1
WARM = 0.1
"""Of the messages, the first that are left out of the latencies (not of the losses)."""


class Outcome(NamedTuple):
    """One way in one round: latencies in us, and how many were lost."""

    p50_us: float
    p99_us: float
    lost: int


def environment(folder: Path) -> dict[str, str]:
    """Return the ends' environment: this host only, run directories of their own."""
    return {
        **os.environ, "ROS_DOMAIN_ID": DOMAIN, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "XDG_RUNTIME_DIR": str(folder), "PYTHONPATH": str(SOURCE), "OPENBLAS_NUM_THREADS": "1",
    }  # fmt: skip


def outcome(file: Path, expected: int | None) -> Outcome:
    """Return what the rows of a reader say; expected None: from its first to its last."""
    rows = np.load(file)
    if not len(rows):
        return Outcome(float("nan"), float("nan"), expected or 0)
    index = np.unique(rows[:, 0])
    lost = (expected or int(index[-1] - index[0]) + 1) - len(index)
    late_us = (rows[:, 2] - rows[:, 1])[round(WARM * len(rows)) :] / 1e3
    return Outcome(float(np.percentile(late_us, 50)), float(np.percentile(late_us, 99)), lost)


class Ends:
    """Starts processes in one folder, and ends them."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.environment = folder, environment(folder)

    def start(self, *command: object, **more: Any) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, *map(str, command)], env=self.environment, text=True, cwd=self.folder, **more
        )

    def ros(self, role: str, topic: str, count: int, last: object) -> subprocess.Popen[str]:
        return self.start(HERE / "ends.py", role, topic, count, last)

    def have_source_send(self, rate_hz: float) -> None:
        """Set how fast the graph's source sends to ROS 2."""
        rate = ["-m", "palp_core", "param", "set", "/source", "rate_hz", rate_hz]
        self.start(*rate, stdout=subprocess.DEVNULL).wait(PATIENCE_S)

    def bridged(self, file: Path, between: Callable[[], None]) -> None:
        """Run a graph and the bridge beside it, and something between."""
        quiet = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        graph = self.start("-m", "palp_core", "launch", HERE / "launch/ends.yaml", f"file:={file}", **quiet)
        while not list(self.folder.glob("palp/*/graph.json")):
            if graph.poll() is not None:
                raise RuntimeError(f"the graph did not begin: {graph.communicate()[1]}")
        bridge = self.start("-m", "palp_core", "bridge", "ros2", HERE / "ends_map.py", **quiet)
        try:
            assert bridge.stdout is not None
            if "bridge to ROS 2" not in bridge.stdout.readline():
                raise RuntimeError(f"the bridge did not begin: {bridge.communicate()[1]}")
            between()
        finally:
            bridge.send_signal(signal.SIGINT)
            said = bridge.communicate(timeout=PATIENCE_S)[1]
            graph.terminate()
            graph.communicate(timeout=PATIENCE_S)
        if said.strip():
            sys.stderr.write(said)


def bare(count: int, rate_hz: float, ends: Ends) -> Outcome:
    """Measure rclpy to rclpy."""
    file = ends.folder / "bare.npy"
    reader = ends.ros("read", "/torque_bare", count, file)
    ends.ros("write", "/torque_bare", count, rate_hz).wait(PATIENCE_S)
    reader.wait(PATIENCE_S)
    return outcome(file, count)


def out(count: int, rate_hz: float, ends: Ends) -> Outcome:
    """Measure graph to rclpy; a source of the graph has the rate of its own parameter."""
    file = ends.folder / "out.npy"

    def between() -> None:
        ends.have_source_send(rate_hz)
        ends.ros("read", "/torque_out", count, file).wait(PATIENCE_S)

    ends.bridged(ends.folder / "unused.npy", between)
    return outcome(file, None)


def into(count: int, rate_hz: float, ends: Ends) -> Outcome:
    """Measure rclpy to graph, whose own source is silent meanwhile: ``bare`` goes one way at a time, too."""
    file = ends.folder / "in.npy"

    def between() -> None:
        ends.have_source_send(SILENT_HZ)
        ends.ros("write", "/torque_in", count, rate_hz).wait(PATIENCE_S)

    ends.bridged(file, between)
    return outcome(file, count)


WAYS: dict[str, Callable[[int, float, Ends], Outcome]] = {"bare": bare, "out": out, "in": into}


def measure(rounds: int, seconds: float, rate_hz: float) -> list[dict[str, Outcome]]:
    """Run all rounds, the order turned from one to the next."""
    found = []
    for number in range(rounds):
        names = list(WAYS) if number % 2 == 0 else list(reversed(WAYS))
        this = {}
        for name in names:
            with tempfile.TemporaryDirectory(prefix="ros2-", ignore_cleanup_errors=True) as folder:
                this[name] = WAYS[name](round(seconds * rate_hz), rate_hz, Ends(Path(folder)))
            sys.stderr.write(f"round {number + 1}, {name}: {this[name]}\n")
        found.append(this)
    return found


def summary(found: list[dict[str, Outcome]]) -> dict[str, Any]:
    """Return medians over rounds, with the least and the largest."""

    def spread(values: list[float]) -> list[float]:
        return [round(float(x), 3) for x in (np.median(values), min(values), max(values))]

    return {
        name: {
            "p50_us": spread([one[name].p50_us for one in found]),
            "p99_us": spread([one[name].p99_us for one in found]),
            "p50_ratio": spread([one[name].p50_us / one["bare"].p50_us for one in found]),
            "p99_ratio": spread([one[name].p99_us / one["bare"].p99_us for one in found]),
            "lost": sum(one[name].lost for one in found),
        }
        for name in WAYS
    }


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=1000.0, help="Hz")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    found = summary(measure(given.rounds, given.seconds, given.rate))
    if given.json:
        print(json.dumps(found))
        return
    for name, row in found.items():
        p50, p99, ratio = row["p50_us"], row["p99_us"], row["p50_ratio"]
        print(
            f"{name:<5} p50 {p50[0]:7.0f} us ({p50[1]:.0f} to {p50[2]:.0f}), p99 {p99[0]:7.0f} us "
            f"({p99[1]:.0f} to {p99[2]:.0f}), p50 over bare {ratio[0]:.2f} "
            f"({ratio[1]:.2f} to {ratio[2]:.2f}), lost {row['lost']}"
        )


if __name__ == "__main__":
    main()
