"""Palpations of launch/emulated.yaml from the sensor to the belief, and beside the simulation of one seed."""

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

from .host import host_words  # noqa: TID252 -- neighbours, of a script and of a package

__all__ = ["ROOT", "palpations", "run_emulated"]

ROOT = Path(__file__).resolve().parents[2]
PATH_M = (-0.03, 0.05)
PATIENCE_S = 3600.0
RINGS_EXACT = {
    "emulated": ("      height_sd_mm: $(var height_sd_mm)\n", "      repeatability_mm: 0.0\n"),
    "sim": ("repeatability_mm: 0.3", "repeatability_mm: 0.0"),
}
"""Where a landing is not drawn, both rings are where they were sent, and sweeps can be compared."""


def palpations(count: int = 10) -> dict[str, Any]:
    """Run a rig on emulated wires for some palpations; return rates, gaps, delays and differences."""
    host = host_words()
    with tempfile.TemporaryDirectory(prefix="palp-bench-") as name:
        folder = Path(name)
        workspace(folder)
        bag, out = folder / "bag", folder / "emulated"
        arguments = (
            "trials:=1", *training(count), f"shared.from_m:={PATH_M[0]}", f"shared.to_m:={PATH_M[1]}",
            f"out:={out}", "--record", str(bag),
        )  # fmt: skip
        rows = out / "trials.csv"
        output = run_emulated(folder, arguments, lambda: rows.exists() and len(read_rows(out)) >= count)
        if not rows.exists() or len(read_rows(out)) < count:
            raise RuntimeError(output)
        palp(folder, "launch", "launch/sim.yaml", "trials:=1", *training(count), f"out:={folder / 'sim'}")
        return {
            "host": host,
            "palpations": len(read_rows(out)),
            **torque(bag),
            **emg(bag),
            **delays(bag),
            **beside_simulation(out, folder / "sim"),
        }


def workspace(folder: Path) -> None:
    """Write both launch files, with rings that land where they are sent, and one path."""
    (folder / "launch").mkdir()
    for link in ("nodes", "msgs", "launch/parts"):
        (folder / link).symlink_to(ROOT / link)
    for name, (old, new) in RINGS_EXACT.items():
        text = (ROOT / "launch" / f"{name}.yaml").read_text(encoding="utf-8")
        text = text.replace(old, old + new if name == "emulated" else new, 1)
        if name == "sim":
            run = "run: nodes.experiment:Experiment\n    params:\n"
            text = text.replace(run, f"{run}      from_m: {PATH_M[0]}\n      to_m: {PATH_M[1]}\n")
        (folder / "launch" / f"{name}.yaml").write_text(text, encoding="utf-8")


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


def training(count: int) -> tuple[str, ...]:
    """Return the argument for at least so many training palpations: fifteen are one of each kind."""
    return (f"training:={-(-count // 15)}",)


def palp(folder: Path, *arguments: str) -> None:
    """Run the command line to its end."""
    subprocess.run(command(*arguments), env=environment(folder), cwd=folder, check=True, capture_output=True)


def command(*arguments: str) -> list[str]:
    """Return a command of palp."""
    return [sys.executable, "-m", "palp_core", *arguments]


def environment(folder: Path) -> dict[str, str]:
    """Return an environment whose graphs nobody else finds."""
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
    """Return how much faster than 1500 Hz the amplifier's clock runs beside the host's, over the run."""
    numbers = np.cumsum(lengths) - lengths
    slope_ns = np.polyfit(numbers, starts_ns - starts_ns[0], 1)[0]
    return float((1e9 / 1500.0 / slope_ns - 1.0) * 1e6)


def delays(bag: Path) -> dict[str, float]:
    """Return how long after a sweep's last sample what it says was told."""
    told_ns, last_ns = (to_numpy(bag, "/estimator/palpation", name) for name in ("stamp_ns", "end_ns"))
    delays_ms = (told_ns - last_ns) * 1e-6
    return {
        "belief_ms_p50": float(np.median(delays_ms)),
        "belief_ms_p99": float(np.percentile(delays_ms, 99)),
        "belief_ms_max": float(delays_ms.max()),
    }


def beside_simulation(emulated: Path, sim: Path) -> dict[str, float]:
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
