"""Palpations and decisions of launch/emulated.yaml, from the sensor to the belief, and as simulated."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.graph.bag.reader import read, to_numpy
from palp_core.palpation.devices.protocols import Int64Array
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.session.trials_csv import read_rows, read_sweep

__all__ = ["decisions", "palpations"]

ROOT = Path(__file__).resolve().parents[2]
PATH_M = (-0.03, 0.05)
PATIENCE_S = 3600.0
EXACT = {"emulated": "phantom.repeatability_mm:=0.0", "sim": "actuator.repeatability_mm:=0.0"}
"""Where a landing is not drawn, both rings are where they were sent, and sweeps can be compared."""
PHANTOMS = 3
AT_REST_M = 2e-6
"""Between two reports of the stage, 10 ms apart: two of its counts."""


def palpations(count: int = 10) -> dict[str, Any]:
    """Run a rig on emulated wires for some palpations; return rates, gaps, delays and differences."""
    with tempfile.TemporaryDirectory(prefix="palp-bench-") as name:
        folder = workspace(Path(name))
        bag, out = folder / "bag", folder / "emulated"
        alike = (
            "trials:=1", f"training:={-(-count // 15)}",  # fifteen are one of each kind
            f"shared.from_m:={PATH_M[0]}", f"shared.to_m:={PATH_M[1]}",
        )  # fmt: skip
        rows = out / "trials.csv"
        arguments = (*alike, EXACT["emulated"], f"out:={out}", "--record", str(bag))
        output = run_emulated(folder, arguments, lambda: rows.exists() and len(read_rows(out)) >= count)
        if not rows.exists() or len(read_rows(out)) < count:
            raise RuntimeError(output)
        simulated = command("launch", "launch/sim.yaml", *alike, EXACT["sim"], f"out:={folder / 'sim'}")
        subprocess.run(simulated, env=environment(folder), cwd=folder, check=True, capture_output=True)
        return {
            "palpations": len(read_rows(out)),
            **torque(bag),
            **emg(bag),
            **delays(bag),
            **compare_simulation(out, folder / "sim"),
        }


def workspace(folder: Path) -> Path:
    """Make a folder that launches the checkout's files, and return it."""
    for link in ("nodes", "msgs", "launch"):
        (folder / link).symlink_to(ROOT / link)
    return folder


def run_emulated(folder: Path, arguments: tuple[str, ...], enough: Callable[[], bool]) -> str:
    """Run launch/emulated.yaml to its end or until enough is done, acknowledging trips; return its output."""
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
        while process.poll() is None and time.monotonic() < end_s and not enough():
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


def torque(bag: Path) -> dict[str, float]:
    """Return how evenly the sensor was polled: a gap is an interval of more than 3 ms."""
    stamps, count, gaps = (
        to_numpy(bag, "/torque/load", name) for name in ("sample_ns", "sample_count", "gap_count")
    )
    steps_ms = np.diff(stamps[count > 0]) * 1e-6 / count[count > 0][1:]
    return {
        "torque_samples": int(count.sum()),
        "torque_hz": float((count.sum() - 1) / (stamps[-1] - stamps[count > 0][0]) * 1e9),
        "torque_gap_rate": float(gaps.sum() / count.sum()),
        "torque_jitter_ms": float(steps_ms.std()),
        "torque_step_p99_ms": float(np.percentile(steps_ms, 99)),
        "torque_step_max_ms": float(steps_ms.max()),
    }


def emg(bag: Path) -> dict[str, float]:
    """Return how much EMG came, and how the clock model moved it between two blocks."""
    starts_ns, rates_hz = (to_numpy(bag, "/emg/block", name) for name in ("start_ns", "rate_hz"))
    gaps = to_numpy(bag, "/emg/report", "gap_count")
    lengths = np.array([len(message.value.fds_v) for message in read(bag, ["/emg/block"])])
    off_ms = (np.diff(starts_ns) - lengths[:-1] * 1e9 / rates_hz[:-1]) * 1e-6
    return {
        "emg_samples": int(lengths.sum()),
        "emg_hz": float(lengths[:-1].sum() / (starts_ns[-1] - starts_ns[0]) * 1e9),
        "emg_gaps": int(gaps.sum()),
        "emg_jitter_us": float(off_ms.std() * 1e3),
        "emg_drift_ppm": drift_ppm(starts_ns, lengths),
    }


def drift_ppm(starts_ns: Int64Array, lengths: Int64Array) -> float:
    """Return how much faster than 1500 Hz the amplifier's clock runs by the host's, over the run."""
    numbers = np.cumsum(lengths) - lengths
    slope_ns = np.polyfit(numbers, starts_ns - starts_ns[0], 1)[0]
    return float((1e9 / 1500.0 / slope_ns - 1.0) * 1e6)


def delays(bag: Path) -> dict[str, float]:
    """Return how long after a sweep's last sample its belief was published."""
    stamp_ns, last_ns = (to_numpy(bag, "/estimator/palpation", name) for name in ("stamp_ns", "end_ns"))
    delays_ms = (stamp_ns - last_ns) * 1e-6
    return {
        "belief_ms_p50": float(np.median(delays_ms)),
        "belief_ms_p99": float(np.percentile(delays_ms, 99)),
        "belief_ms_max": float(delays_ms.max()),
    }


def compare_simulation(emulated: Path, sim: Path) -> dict[str, float]:
    """Return how far the emulated run's training sweeps are from the simulation's of the same seed."""
    peaks, means, sds = [], [], []
    for k, (one, other) in enumerate(zip(read_rows(emulated), read_rows(sim), strict=False)):
        same = (one.phase, one.phantom, one.ring_m) == (other.phase, other.phantom, other.ring_m)
        if one.phase != "training" or not same:
            break
        pair = [read_sweep(out, k)[0] for out in (emulated, sim)]
        length = min(map(len, pair))
        off_n_mm = (pair[0][:length] - pair[1][:length]) * 1e3
        peaks.append((one.peak_n_m - other.peak_n_m) * 1e3)
        means.append(off_n_mm.mean())
        sds.append(off_n_mm.std())
    return {
        "compared_sweeps": len(peaks),
        "peak_off_n_mm_max": float(np.max(np.abs(peaks))),
        "peak_off_n_mm_mean": float(np.mean(peaks)),
        "sweep_bias_n_mm_max": float(np.max(np.abs(means))),
        "sweep_off_sd_n_mm": float(np.mean(sds)),
        "resolution_n_mm": RESOLUTION_N_M * 1e3,
    }


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
        output = run_emulated(folder, arguments, lambda: False)
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
