"""From a sample to the screen, and how often it is drawn: told by the browser, on the host's clock."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.view_bench.running import Launched, browser, emulated, end, spread, wait
from palp_core.units import Float64Array
from tests.support.view.browser import Viewing

SIGNALS = {"torque, 1 kHz": ("/torque/block", "torque_n_m"), "EMG, 1.5 kHz": ("/emg/block", "fds_v")}
WATCH = """() => {
  const plot = document.querySelector('.live-plot');
  window.drawn = [];
  new MutationObserver(() => {
    const newest = Number(plot.dataset.newest);
    requestAnimationFrame(() => window.drawn.push([performance.timeOrigin + performance.now(), newest]));
  }).observe(plot, { attributes: true, attributeFilter: ['data-frames'] });
}"""
"""Note, when the frame after a drawing begins (so it is on the screen), its newest sample."""
BEHIND = """() => {
  let most = -Infinity;
  for (let i = 0; i < 100000; i++) {
    most = Math.max(most, Date.now() - performance.timeOrigin - performance.now());
  }
  return most;
}"""
"""How far the browser's fine clock is behind the host's, in ms: the host's is told in whole ones."""
STEP_S = 1e-3


def to_screen(seconds: float, rounds: int, *, beside: bool) -> dict[str, Any]:
    """Return p95 from sample to screen, and frames a second, of torque and EMG, the emulated rig at work."""
    found: dict[str, dict[str, list[float]]] = {
        name: {"p50_ms": [], "p95_ms": [], "frames_hz": []} for name in SIGNALS
    }
    with tempfile.TemporaryDirectory() as name, emulated() as run:
        process = run.view()
        with browser(Path(name), beside=beside) as chrome:
            viewing = Viewing(chrome, process)
            for _ in range(rounds):
                for signal, (topic, field) in SIGNALS.items():
                    viewing.go(f"/topic{topic}")
                    viewing.plot(field)
                    times_s, newest_s = _watch(run, viewing, seconds)
                    ages_ms = 1e3 * ages(times_s, newest_s)
                    found[signal]["p50_ms"].append(float(np.median(ages_ms)))
                    found[signal]["p95_ms"].append(float(np.percentile(ages_ms, 95)))
                    span_s = float(times_s[-1] - times_s[0])
                    found[signal]["frames_hz"].append((len(times_s) - 1) / span_s)
        end(process)
    return {name: {what: spread(values, 1) for what, values in rows.items()} for name, rows in found.items()}


def _watch(run: Launched, viewing: Viewing, seconds: float) -> tuple[Float64Array, Float64Array]:
    """Return when each frame was on the screen and its newest sample, in s of the graph's clock."""
    behind_ms = float(viewing.page.evaluate(BEHIND))
    viewing.page.evaluate(WATCH)
    wait(seconds)
    rows = np.array(viewing.page.evaluate("window.drawn"), dtype=float)
    rows = rows[np.isfinite(rows[:, 1])]  # before the first sample there was none
    clock = run.graph.ask("graph", "clock")
    unix_ns, here_ns = time.time_ns(), time.monotonic_ns()
    began_ns = clock["monotonic_ns"] - clock["now_ns"]
    shown_ns = (rows[:, 0] + behind_ms) * 1e6 - (unix_ns - here_ns) - began_ns
    return shown_ns / 1e9, rows[:, 1]


def ages(times_s: Float64Array, newest_s: Float64Array) -> Float64Array:
    """Return how old each sample was when it was first on the screen.

    Args:
        times_s: When each frame was, shape (n,).
        newest_s: The newest sample on it.

    >>> ages(np.array([1.0, 2.0]), np.array([0.9, 1.9]))[[0, -1]].round(3).tolist()
    [1.099, 0.1]
    """
    found = [
        shown_s - np.arange(last_s, before_s, -STEP_S)[::-1]
        for shown_s, before_s, last_s in zip(times_s[1:], newest_s, newest_s[1:], strict=False)
    ]
    return np.concatenate(found) if found else np.empty(0)
