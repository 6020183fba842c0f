"""The long run: torque at 1 kHz and EMG at 1.5 kHz in wall time; losses, overruns, jitter, memory."""

from __future__ import annotations

import json
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray
from wire_bench.charts import jitter_chart
from wire_bench.contenders import HERE, environment, palp_command

__all__ = ["steady"]

SAMPLE_S = 2.0
WARM_S = 10.0
RATES_HZ = {"torque": 1000.0, "emg": 1500.0, "estimator": 100.0, "policy": 20.0}
EDGES = {("estimator", "torque"): "torque", ("estimator", "emg"): "emg"}


def _pids(folder: Path) -> dict[str, int]:
    for record in folder.glob("palp/*/graph.json"):
        said = json.loads(record.read_text(encoding="utf-8"))
        return {"launcher": said["pid"], **{node["name"]: node["pid"] for node in said["nodes"]}}
    return {}


def _watch(process: subprocess.Popen[str], folder: Path) -> dict[str, list[tuple[float, int, float]]]:
    """Return (time in s, resident bytes, CPU s) of each process, every two seconds until the end."""
    seen: dict[str, list[tuple[float, int, float]]] = {}
    begin_s = time.monotonic()
    while True:
        try:
            process.wait(SAMPLE_S)
        except subprocess.TimeoutExpired:
            for name, pid in _pids(folder).items():
                try:
                    one = psutil.Process(pid)
                    row = (time.monotonic() - begin_s, one.memory_info().rss, sum(one.cpu_times()[:2]))
                except psutil.Error:
                    continue
                seen.setdefault(name, []).append(row)
        else:
            return seen


def _growth(rows: list[tuple[float, int, float]]) -> dict[str, float]:
    """Return how resident memory grew after the first seconds, and the share of a core used."""
    times_s, sizes, busy_s = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    warm = times_s >= min(times_s[0] + WARM_S, times_s[len(times_s) // 2])
    span_s = max(times_s[-1] - times_s[0], 1e-9)
    slope = np.polyfit(times_s[warm], sizes[warm], 1)[0] if warm.sum() > 2 else 0.0
    return {
        "rss_mib": sizes[-1] / 2**20,
        "grown_kib": (sizes[-1] - sizes[warm][0]) / 1024,
        "kib_per_min": slope * 60 / 1024,
        "core_share": (busy_s[-1] - busy_s[0]) / span_s,
    }


def _timer(late_ns: NDArray[np.int64], rate_hz: float) -> dict[str, float]:
    overruns = int((late_ns >= 1e9 / rate_hz).sum())
    return {
        "ticks": int(late_ns.size),
        "overruns": overruns,
        "overruns_percent": 100.0 * overruns / late_ns.size,
        "late_p50_us": float(np.quantile(late_ns, 0.5)) / 1e3,
        "late_p99_us": float(np.quantile(late_ns, 0.99)) / 1e3,
        "late_p99_9_us": float(np.quantile(late_ns, 0.999)) / 1e3,
        "late_max_us": float(late_ns.max()) / 1e3,
    }


def steady(seconds: float, out: Path | None) -> dict[str, Any]:
    """Run the graph and return losses, overruns and memory; write the histogram to ``out``.

    Raises:
        RuntimeError: The graph failed.
    """
    with tempfile.TemporaryDirectory(prefix="wires-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        command = palp_command("launch", HERE / "launch/steady.yaml", f"out:={name}", f"seconds:={seconds}")
        said = folder / "said.txt"
        with said.open("w", encoding="utf-8") as file:
            process = subprocess.Popen(
                command, env=environment(folder), stdout=file, stderr=subprocess.STDOUT, text=True
            )
            try:
                seen = _watch(process, folder)
            finally:
                process.kill()
                process.wait()
        if process.returncode:
            text = said.read_text(encoding="utf-8")
            raise RuntimeError(f"palp launch steady.yaml ended with {process.returncode}: {text}")
        late = {node: np.load(folder / f"{node}.tick.npy") for node in RATES_HZ}
        sent = {node: int(np.load(folder / f"{node}.sent.npy")[0]) for node in ("torque", "emg")}
        received = {edge: int(np.load(folder / f"{'.'.join(edge)}.npy")[0]) for edge in EDGES}
        result_count, result_last = np.load(folder / "policy.torque.npy")
    slow = [_timer(late[node], rate_hz) for node, rate_hz in RATES_HZ.items() if rate_hz <= 100.0]
    if out is not None:
        jitter_chart(late["torque"], out / "jitter.png", seconds)
    return {
        "seconds": seconds,
        "sent": sent,
        "lost": sum(sent[p] - received[e] for e, p in EDGES.items()) + int(result_last - result_count),
        "timers": {node: _timer(late[node], rate_hz) for node, rate_hz in RATES_HZ.items()},
        "overruns_up_to_100_hz_percent": 100.0
        * sum(t["overruns"] for t in slow)
        / sum(t["ticks"] for t in slow),
        "processes": {node: _growth(rows) for node, rows in seen.items()},
    }
