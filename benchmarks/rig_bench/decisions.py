"""Decisions within the sweep of launch/emulated.yaml, from the sensor to the belief."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.graph.bag.reader import read, to_numpy
from palp_core.palpation.session.trials_csv import read_rows

__all__ = ["decisions"]

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 3600.0
PHANTOMS = 3
AT_REST_M = 2e-6
"""Between two reports of the stage, 10 ms apart: two of its counts."""


def workspace(folder: Path) -> Path:
    """Make a folder that launches the checkout's files, and return it."""
    for link in ("nodes", "msgs", "launch"):
        (folder / link).symlink_to(ROOT / link)
    return folder


def run_emulated(folder: Path, arguments: tuple[str, ...]) -> str:
    """Run launch/emulated.yaml to its end, acknowledging trips; return its output."""
    path, pause, end_s, acknowledged = (
        folder / "output.log",
        threading.Event(),
        time.monotonic() + PATIENCE_S,
        0,
    )
    words = ("launch", "launch/emulated.yaml", "host:=127.0.99.1", *arguments)
    with path.open("w", encoding="utf-8") as output:
        process = subprocess.Popen(
            command(*words), env=environment(folder), cwd=folder, stdout=output, stderr=output
        )
        while process.poll() is None and time.monotonic() < end_s:
            trips = path.read_text(encoding="utf-8").count("/safety: tripped")
            if trips > acknowledged:
                subprocess.run(command("safety", "ack"), env=environment(folder), cwd=folder, check=False)
                acknowledged = trips
            pause.wait(0.5)
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.wait(60.0)
    return path.read_text(encoding="utf-8")


def command(*arguments: str) -> list[str]:
    """Return a command of palp."""
    return [sys.executable, "-m", "palp_core", *arguments]


def environment(folder: Path) -> dict[str, str]:
    """Return an environment with run directories of its own."""
    runs = folder / "run"
    runs.mkdir(exist_ok=True)
    return {**os.environ, "XDG_RUNTIME_DIR": str(runs), "PYTHONPATH": str(ROOT / "src")}


def decisions(count: int = 201, *, stale_ms: float = 0.0, beat_ms: float = 0.0) -> dict[str, Any]:
    """Run trials that are decided within the sweep, at one position; return how soon.

    Args:
        count: Trials, on three phantoms.
        stale_ms: Longest time without a sample of torque; 0: the launch file's.
        beat_ms: Longest time without a heartbeat; 0: the launch file's.
    """
    each = -(-count // PHANTOMS)
    deadlines = {"stale_ms": stale_ms, "beat_ms": beat_ms}
    with tempfile.TemporaryDirectory(prefix="palp-bench-") as name:
        folder = workspace(Path(name))
        bag, out = folder / "bag", folder / "out"
        arguments = (
            "protocol:=swift", "policy:=fixed", "rings_mm:=16", "training:=4", f"trials:={each}",
            f"out:={out}", "--record", str(bag),
            *(f"shared.{key}:={value}" for key, value in deadlines.items() if value),
        )  # fmt: skip
        output = run_emulated(folder, arguments)
        rows = [row for row in read_rows(out) if row.phase == "estimation"]
        return {
            "trials": len({row.trial for row in rows}),
            "trips": [line for line in output.splitlines() if "/safety: tripped" in line],
            **_lateness(bag),
            **_way_on(bag),
        }


def _lateness(bag: Path) -> dict[str, float]:
    """Return how long after a block's last sample its belief was published."""
    stamp_ns, last_ns = (to_numpy(bag, "/estimator/outlook", name) for name in ("stamp_ns", "sample_ns"))
    late_ms = (stamp_ns - last_ns) * 1e-6
    return {
        "beliefs": len(late_ms),
        **{f"belief_ms_p{p}": float(np.percentile(late_ms, p)) for p in (50, 99)},
        "belief_ms_max": float(late_ms.max()),
    }


def _way_on(bag: Path) -> dict[str, float]:
    """Return how far the stage goes on after the first "decided" of each trial, by its own reports."""
    when_ns, y_m = (to_numpy(bag, "/stage/report", name) for name in ("stamp_ns", "y_m"))
    way_mm, seen = [], set[int]()
    for message in read(bag, ["/estimator/outlook"]):
        outlook = message.value
        if outlook.verdict != "decided" or outlook.trial in seen:
            continue
        seen.add(outlook.trial)
        first = int(np.searchsorted(when_ns, outlook.stamp_ns))
        resting = np.flatnonzero(np.abs(np.diff(y_m[first:])) <= AT_REST_M)
        at_decision_m = np.interp(outlook.stamp_ns, when_ns, y_m)
        way_mm.append(abs(y_m[first + int(resting[0])] - at_decision_m) * 1e3)
    return {
        "decided_in_sweep": len(way_mm),
        "way_on_mm_p50": float(np.median(way_mm)),
        "way_on_mm_max": float(np.max(way_mm)),
    }
