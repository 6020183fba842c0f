"""Decisions within the sweep on launch/emulated.yaml: how soon, and how far the stage goes on."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.graph.bag.reader import read, to_numpy
from palp_core.palpation.session.trials_csv import read_rows

from .host import host_words  # noqa: TID252 -- neighbours, of a script and of a package
from .palpations import ROOT, run_emulated  # noqa: TID252

__all__ = ["decisions"]

PHANTOMS = 3
AT_REST_M = 2e-6
"""Between two reports of the stage, 10 ms apart: two of its counts."""


def decisions(count: int = 201, *, stale_ms: float = 0.0, beat_ms: float = 0.0) -> dict[str, Any]:
    """Run trials that are decided within the sweep, at one position; return how soon.

    Args:
        count: Trials, on three phantoms.
        stale_ms: Longest time without a sample of torque; 0: the launch file's.
        beat_ms: Longest time without a heartbeat; 0: the launch file's.
    """
    host, each = host_words(), -(-count // PHANTOMS)
    deadlines = {"stale_ms": stale_ms, "beat_ms": beat_ms}
    with tempfile.TemporaryDirectory(prefix="palp-bench-") as name:
        folder = Path(name)
        for link in ("nodes", "msgs", "launch"):
            (folder / link).symlink_to(ROOT / link)
        bag, out = folder / "bag", folder / "out"
        arguments = (
            "protocol:=swift", "policy:=fixed", "rings_mm:=16", "training:=4", f"trials:={each}",
            f"out:={out}", "--record", str(bag),
            *(f"shared.{key}:={value}" for key, value in deadlines.items() if value),
        )  # fmt: skip
        output = run_emulated(folder, arguments, lambda: False)
        rows = [row for row in read_rows(out) if row.phase == "estimation"]
        return {
            "host": host,
            "trials": len({row.trial for row in rows}),
            "trips": [line for line in output.splitlines() if "/safety: tripped" in line],
            **_lateness(bag),
            **_way_on(bag),
        }


def _lateness(bag: Path) -> dict[str, float]:
    """Return how long after a block's last sample the belief of it was told."""
    told_ns, last_ns = (to_numpy(bag, "/estimator/outlook", name) for name in ("stamp_ns", "sample_ns"))
    late_ms = (told_ns - last_ns) * 1e-6
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
