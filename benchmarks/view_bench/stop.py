"""From a click on stop to ABORT at the controller, while nothing or much else is pressed."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rig_bench.running import RunningRig
from benchmarks.rig_bench.trips import acknowledged
from benchmarks.view_bench.running import ROOT, browser, end, stop_button
from benchmarks.view_bench.screen import BEHIND
from tests.support.palp import PATIENCE_S
from tests.support.view.browser import Viewing

SHORT = ("trials:=1", "training:=1")
CLICKS = """() => {
  window.clicks = [];
  const note = event => window.clicks.push(performance.timeOrigin + event.timeStamp);
  document.addEventListener('click', note, true);
}"""
"""Note when the browser had a click from the mouse: before any of the page's own code."""


def stops(clicks: int, *, loaded: bool, beside: bool) -> dict[str, Any]:
    """Return how long a click takes to the first ABORT that the kernel of the controller's host has received.

    Args:
        clicks: So many; after each the trip is acknowledged.
        loaded: Another browser swaps the policy, and loads pages meanwhile.
        beside: The browsers have the priority of the graph.
    """
    took_ms: list[float] = []
    with (
        tempfile.TemporaryDirectory(prefix="palp-view-") as name,
        RunningRig(Path(name), *SHORT, patience_s=PATIENCE_S) as rig,
    ):
        rig.put_on()
        with _viewer(rig) as process, browser(Path(name), beside=beside) as chrome:
            viewing = Viewing(chrome, process)
            with _others(viewing.address) if loaded else _nobody():
                viewing.page.evaluate(CLICKS)
                button = stop_button(viewing)
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


@contextmanager
def _others(address: str) -> Iterator[None]:
    """Let somebody else press everything at the same viewer."""
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.view_bench.presses", address],
        cwd=ROOT, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        process.stdout.readline()
        yield
    finally:
        end(process)


@contextmanager
def _nobody() -> Iterator[None]:
    yield
