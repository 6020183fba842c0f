"""The host on which the rig is measured."""

from __future__ import annotations

import os
import platform
from pathlib import Path

__all__ = ["host_words"]


def host_words() -> str:
    """Describe the host and its load."""
    limits = Path("/proc/sys/kernel/sched_rt_runtime_us")
    share = limits.read_text(encoding="utf-8").strip() if limits.exists() else "?"
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    return (
        f"{os.cpu_count()} cores, Linux {platform.release()}, Python {platform.python_version()},"
        f" real-time share {share} us of a second, load before {load}"
    )
