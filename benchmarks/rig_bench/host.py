"""What else the host does while the rig is measured: nothing, or work on every core; and what host it is."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["host_words", "loaded", "without_collector"]

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
