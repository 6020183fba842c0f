"""The host while the rig is measured: what else it does, where it stands still, what it is."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["holes", "host_words", "loaded", "without_collector"]

_NEVER_COLLECT = "import gc\ngc.disable()\ngc.enable = gc.disable\n"


@contextmanager
def loaded(count: int) -> Iterator[None]:
    """Keep so many cores busy with ordinary priority."""
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()


_SLEEPER = """
import os, sys, time
os.sched_setaffinity(0, {int(sys.argv[1])})
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(os.sched_get_priority_max(os.SCHED_FIFO)))
before = time.monotonic_ns()
while True:
    time.sleep(0.001)
    now = time.monotonic_ns()
    if now - before > 10_000_000:
        print(f"{(now - before) / 1e6:.1f}", flush=True)
    before = now
"""
"""Sleeps a millisecond at a time at the highest real-time priority: it is late only where the machine is."""


@contextmanager
def holes() -> Iterator[dict[str, list[float]]]:
    """Watch each core for times over 10 ms in which nothing ran; none are seen without real-time priority.

    Yields:
        Their lengths in ms by core, once the block has ended.
    """
    seen: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory(prefix="palp-bench-") as name:
        paths = {core: Path(name) / str(core) for core in sorted(os.sched_getaffinity(0))}
        sleepers = []
        for core, path in paths.items():
            with path.open("w", encoding="utf-8") as said:
                words = [sys.executable, "-c", _SLEEPER, str(core)]
                sleepers.append(subprocess.Popen(words, stdout=said, stderr=subprocess.DEVNULL))
        try:
            yield seen
        finally:
            for sleeper in sleepers:
                sleeper.kill()
                sleeper.wait()
            for core, path in paths.items():
                seen[f"core {core}"] = [float(word) for word in path.read_text(encoding="utf-8").split()]


def without_collector(folder: Path) -> Path:
    """Write what keeps Python's collector from running in every process that has ``folder`` on its path."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "sitecustomize.py").write_text(_NEVER_COLLECT, encoding="utf-8")
    return folder


def host_words() -> str:
    """Say what was measured on."""
    limits = Path("/proc/sys/kernel/sched_rt_runtime_us")
    share = limits.read_text(encoding="utf-8").strip() if limits.exists() else "?"
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    return (
        f"{os.cpu_count()} cores, Linux {platform.release()}, Python {platform.python_version()},"
        f" real-time share {share} us of a second, load before {load}"
    )
