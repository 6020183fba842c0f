"""How soon the rig stops: from a torque over the limit to ABORT, and after the death or stop of a node."""

from __future__ import annotations

import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from .running import LAUNCHER, RunningRig  # noqa: TID252 -- neighbours, of a script and of a package

__all__ = ["NODES", "deaths", "trips"]

SHORT = ("trials:=1", "training:=1")
OVER_N_MM = 180.0
NODES = (
    "stage", "actuator", "torque", "safety", "policy", "estimator", "emg", "cocontraction", "experiment",
    "phantom", LAUNCHER,
)  # fmt: skip
EDGES_MS = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.5, 10.0, 20.0, 50.0, 1000.0)
GIVE_UP_NS = 5_000_000_000


@contextmanager
def running() -> Iterator[RunningRig]:
    """Run the rig for a while."""
    with (
        tempfile.TemporaryDirectory(prefix="palp-bench-") as folder,
        RunningRig(Path(folder), *SHORT) as rig,
    ):
        rig.put_on()
        yield rig


def trips(at_rest: int, sweeping: int) -> dict[str, Any]:
    """Return how long a torque over the limit takes to the ABORT at the controller, and how far a sweep goes.

    The time is from when the sensor took the first sample over the limit, so 0.5 ms on a bus of 500 kbit/s
    are in it, to when the kernel of the controller's host received the ABORT.
    """
    others = 0
    latencies_ms: list[float] = []
    beyond_mm: list[float] = []
    with running() as rig:
        while len(latencies_ms) < at_rest + sweeping:
            moving = len(latencies_ms) >= at_rest
            rig.until(lambda m=moving: permitted(rig) and (not m or rig.sweeping()), "permission")  # type: ignore[misc]
            rig.emulator.send(f"load {OVER_N_MM}")
            latency_ms = wait_for_abort(rig)
            if latency_ms is not None:
                latencies_ms.append(latency_ms)
                if moving:
                    rig.until(rig.stage.at_rest, "rest")
                    axes = rig.stage.axes()
                    beyond_mm.append(abs(axes["y"]["position_m"] - axes["felt_y_m"]) * 1e3)
            else:  # it had tripped for another reason just before
                others += 1
            rig.emulator.send("load 0")
            rig.until(lambda: acknowledged(rig), "acknowledgement")
    counts, _ = np.histogram(latencies_ms, EDGES_MS)
    return {
        "trips": len(latencies_ms),
        "for_another_cause": others,
        "ms_p50": round(float(np.median(latencies_ms)), 3),
        "ms_p99": round(float(np.percentile(latencies_ms, 99)), 3),
        "ms_max": round(max(latencies_ms), 3),
        "histogram_ms": {f"< {high:g}": int(n) for high, n in zip(EDGES_MS[1:], counts, strict=True)},
        "sweeping_trips": len(beyond_mm),
        "beyond_mm_p50": round(float(np.median(beyond_mm)), 3) if beyond_mm else 0.0,
        "beyond_mm_max": round(max(beyond_mm, default=0.0), 3),
    }


def wait_for_abort(rig: RunningRig) -> float | None:
    """Return how long after the first sample over the limit ABORT came, in ms; None if all stood before."""
    found: list[float | None] = []

    def look() -> bool:
        felt_ns = rig.stage.axes()["felt_ns"]
        aborts = rig.stage.aborts(felt_ns) if felt_ns else []
        found.extend((when - felt_ns) * 1e-6 for when in aborts[:1])
        cause = rig.safety()["cause"]
        if cause and cause not in ("torque", "saturated"):
            found[:] = [None]
        return bool(found)

    rig.until(look, "ABORT")
    return found[0]


def permitted(rig: RunningRig) -> bool:
    """Acknowledge until nothing is wrong any more; return whether motion is permitted."""
    status = rig.safety()
    if status["cause"]:
        rig.call("safety", "acknowledge")
    return bool(status["permits"])


def acknowledged(rig: RunningRig) -> bool:
    """Acknowledge; return whether no trip is left."""
    rig.call("safety", "acknowledge")
    return not rig.safety()["cause"]


def deaths(nodes: tuple[str, ...] = NODES, repeats: int = 1) -> dict[str, dict[str, Any]]:
    """Return how long after a signal to a node the stage rests, in ms, per node and signal.

    Each is the worst of the repeats, with how far the sweep went on in mm.
    """
    found: dict[str, dict[str, Any]] = {}
    for node in nodes:
        for number in (signal.SIGKILL, signal.SIGSTOP):
            rows = [death(node, number) for _ in range(repeats)]
            worst = {
                "rest_ms": round(max(row[0] for row in rows), 1),
                "beyond_mm": round(max(row[1] for row in rows), 2),
            }
            found.setdefault(node, {})[number.name] = worst
            print(f"{node} {number.name}: {worst}", file=sys.stderr)
    return found


def death(node: str, number: signal.Signals) -> tuple[float, float]:
    """Return how long after a signal to a node in a sweep the stage rests, in ms, and its way in mm.

    Several processes at once: their names with ``+`` between them.
    """
    with running() as rig:
        rig.until(lambda: permitted(rig) and rig.sweeping(), "sweep")
        before = rig.stage.axes()
        rig.signal(number, *node.split("+"))
        until_ns = time.monotonic_ns() + GIVE_UP_NS
        while not rig.stage.at_rest() and time.monotonic_ns() < until_ns:
            pass
        moved_s = (rig.signalled_ns - before["now_ns"]) * 1e-9
        struck_m = before["y"]["position_m"] + before["y"]["velocity_m_per_s"] * moved_s
        return rig.stop_ms(), (rig.stage.axes()["y"]["position_m"] - struck_m) * 1e3
