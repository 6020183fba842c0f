"""How soon the rig stops: trips at rest and in a sweep, and the death or stop of every node."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from rig_bench.running import RunningRig

__all__ = ["deaths", "trips"]

SHORT = ("trials:=1", "training:=1", "stale_ms:=100.0", "beat_ms:=200.0")
FIRM = ("trials:=1", "training:=1", "stale_ms:=25.0", "beat_ms:=50.0")
NODES = ("experiment", "policy", "stage", "actuator", "torque", "estimator", "emg", "cocontraction", "safety")


@contextmanager
def running(*arguments: str) -> Iterator[RunningRig]:
    sys.setswitchinterval(0.0005)  # this process is the devices, and looks at them too
    with (
        tempfile.TemporaryDirectory(prefix="palp-bench-") as folder,
        RunningRig(Path(folder), *arguments) as rig,
    ):
        with contextlib.suppress(PermissionError):  # the devices' thread, as the emulated rig's node has it
            rig.emulated.reactor.call(first_in_line)
            first_in_line()  # it holds the interpreter's lock at times, and then the devices wait for it
        rig.put_on()
        yield rig


def first_in_line() -> None:
    """Give this thread, and no child of this process, a real-time priority."""
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(25))


def trips(at_rest: int, sweeping: int) -> dict[str, Any]:
    """Return how long a saturated gauge takes to the ABORT at the controller, and how far a sweep goes on."""
    latencies_ms, beyond_mm = [], []
    with running(*SHORT) as rig:
        for k in range(at_rest + sweeping):
            moving = k >= at_rest
            if moving:
                rig.sweep()
            else:
                rig.until(lambda: permitted(rig), "permission")
            set_ns, from_m = saturate(rig)
            rig.until(lambda since=set_ns: aborts(rig, since), "ABORT")  # type: ignore[misc]
            latencies_ms.append((aborts(rig, set_ns)[0] - set_ns) * 1e-6)
            if moving:
                rig.until(rig.at_rest, "rest")
                rest_m = rig.emulated.on_world(lambda world, now: world.axes["y"].position_m(now))
                beyond_mm.append(abs(rest_m - from_m) * 1e3)
            rig.emulated.clear("ati")
            rig.until(lambda: rig.call("safety", "acknowledge")["done"], "acknowledgement")
    return {
        "trips": len(latencies_ms),
        "ms_p50": float(np.median(latencies_ms)),
        "ms_p99": float(np.percentile(latencies_ms, 99)),
        "ms_max": max(latencies_ms),
        "sweeping_trips": len(beyond_mm),
        "beyond_mm_p50": float(np.median(beyond_mm)) if beyond_mm else 0.0,
        "beyond_mm_max": max(beyond_mm, default=0.0),
    }


def permitted(rig: RunningRig) -> bool:
    """Acknowledge until nothing is wrong any more; tell whether motion is permitted."""
    status = rig.safety()
    if status["cause"]:
        rig.call("safety", "acknowledge")
    return bool(status["permits"])


def saturate(rig: RunningRig) -> tuple[int, float]:
    """Saturate a gauge; return when, and where the stage was."""

    def now(world: Any, now_ns: int) -> tuple[int, float]:
        world.saturated_gauges = (2,)
        return now_ns, world.axes["y"].position_m(now_ns)

    found: tuple[int, float] = rig.emulated.on_world(now)
    return found


def aborts(rig: RunningRig, since_ns: int) -> list[int]:
    """Return when ABORT was heard."""
    return [stamp_ns for stamp_ns, _, line in rig.log(since_ns) if line.startswith("ABORT")]


def deaths() -> dict[str, dict[str, float]]:
    """Return how long after a signal to a node the stage rests, in ms, per node and signal."""
    found: dict[str, dict[str, float]] = {}
    for node in NODES:
        for number in (signal.SIGKILL, signal.SIGSTOP):
            with running(*FIRM) as rig:
                rig.sweep()
                rig.signal(node, number)
                until_ns = time.monotonic_ns() + 5_000_000_000
                while not aborts(rig, rig.signalled_ns) and time.monotonic_ns() < until_ns:
                    pass
                found.setdefault(node, {})[number.name] = rig.stop_ms()
    return found
