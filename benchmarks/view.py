"""How soon ``palp view`` shows a sample, and how soon its stop arrives.

Each viewer has a page of Chromium, which gets what time the host has left, as if it were on another one. Each
number is a median over rounds, with the least and the largest. The machine should be otherwise idle.

Run: .venv/bin/python -m benchmarks.view [screen|stop] [--rounds N] [--clicks N]

screen: from sample to screen, and frames a second, the emulated rig running. stop: from a click to ABORT on
the wire.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rig_bench.emulator import host_words
from benchmarks.rig_bench.running import RunningRig
from benchmarks.rig_bench.trips import acknowledged
from benchmarks.view_running import ROOT, Launched, browser, emulated, end, wait
from palp_core.units import Float64Array
from tests.support.palp import PATIENCE_S
from tests.support.view.browser import Viewing

WINDOW_S = 4.0
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


CLICKS = """() => {
  window.clicks = [];
  const note = event => window.clicks.push(performance.timeOrigin + event.timeStamp);
  document.addEventListener('click', note, true);
}"""
"""Note when the browser had a click from the mouse: before any of the page's own code."""


def to_screen(rounds: int) -> dict[str, Any]:
    """Return p95 from sample to screen, and frames a second, of torque and EMG, the emulated rig running."""
    found: dict[str, dict[str, list[float]]] = {name: {"p95_ms": [], "frames_hz": []} for name in SIGNALS}
    with tempfile.TemporaryDirectory() as name, emulated() as run:
        process = run.view()
        with browser(Path(name)) as chrome:
            viewing = Viewing(chrome, process)
            for _ in range(rounds):
                for signal_name, (topic, field) in SIGNALS.items():
                    viewing.go(f"/topic{topic}")
                    viewing.plot(field)
                    times_s, newest_s = _watch(run, viewing)
                    found[signal_name]["p95_ms"].append(
                        float(np.percentile(1e3 * ages(times_s, newest_s), 95))
                    )
                    span_s = float(times_s[-1] - times_s[0])
                    found[signal_name]["frames_hz"].append((len(times_s) - 1) / span_s)
        end(process)
    return {name: {what: spread(values) for what, values in rows.items()} for name, rows in found.items()}


def _watch(run: Launched, viewing: Viewing) -> tuple[Float64Array, Float64Array]:
    """Return when each frame was on the screen and its newest sample, in s of the graph's clock."""
    behind_ms = float(viewing.page.evaluate(BEHIND))
    viewing.page.evaluate(WATCH)
    wait(WINDOW_S)
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


def stops(clicks: int) -> dict[str, Any]:
    """Return how long a click takes to the first ABORT that the kernel of the controller's host has received.

    After each click the trip is acknowledged.
    """
    took_ms: list[float] = []
    with (
        tempfile.TemporaryDirectory(prefix="palp-view-") as name,
        RunningRig(Path(name), "trials:=1", "training:=1", patience_s=PATIENCE_S) as rig,
    ):
        rig.put_on()
        with _viewer(rig) as process, browser(Path(name)) as chrome:
            viewing = Viewing(chrome, process)
            viewing.page.evaluate(CLICKS)
            button = viewing.page.get_by_role("button", name=re.compile("^stop", re.IGNORECASE)).first
            for _ in range(clicks):
                rig.until(lambda: acknowledged(rig) and rig.safety()["permits"], "permission")
                took_ms.append(_stop_ms(rig, viewing, button))
    return {
        "clicks": len(took_ms),
        **{f"p{p}_ms": round(float(np.percentile(took_ms, p)), 1) for p in (50, 99)},
        "max_ms": round(max(took_ms), 1),
    }


def _stop_ms(rig: RunningRig, viewing: Viewing, button: Any) -> float:
    since_ns = time.monotonic_ns()
    button.click()
    rig.until(lambda: rig.stage.aborts(since_ns), "ABORT")
    aborted_ns = rig.stage.aborts(since_ns)[0]
    clicked_ms = float(viewing.page.evaluate("window.clicks[window.clicks.length - 1]"))
    behind_ms = float(viewing.page.evaluate(BEHIND))
    here_ns = time.time_ns() - time.monotonic_ns()
    return (aborted_ns + here_ns) / 1e6 - clicked_ms - behind_ms


@contextmanager
def _viewer(rig: RunningRig) -> Iterator[subprocess.Popen[str]]:
    words = ("view", "--no-browser", "--operate", "--graph", rig.graph.record.id)
    process = subprocess.Popen(
        [sys.executable, "-m", "palp_core", *words],
        env={**os.environ, "XDG_RUNTIME_DIR": str(rig.run_folder), "PYTHONPATH": str(ROOT / "src")},
        cwd=rig.folder, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        yield process
    finally:
        end(process)


def spread(values: list[float]) -> dict[str, float]:
    """Return median, least and largest.

    >>> spread([3.0, 1.0, 2.0])
    {'median': 2.0, 'min': 1.0, 'max': 3.0}
    """
    found = {"median": float(np.median(values)), "min": min(values), "max": max(values)}
    return {name: round(value, 1) for name, value in found.items()}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("screen", "stop"))
    parser.add_argument("--rounds", type=int, default=7, help="of screen")
    parser.add_argument("--clicks", type=int, default=200, help="on stop")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that nothing is left behind
    found = to_screen(options.rounds) if options.what == "screen" else stops(options.clicks)
    print(json.dumps({"host": host_words(), **found}))


if __name__ == "__main__":
    main()
