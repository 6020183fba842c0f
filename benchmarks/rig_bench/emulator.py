"""Emulated devices in a process of their own, which takes commands by line."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import msgspec

from palp_core.palpation.devices.emulator import RigSettings

__all__ = ["PRIORITY", "EmulatorProcess", "emulator", "host_words"]

PRIORITY = 25
"""Above every node of the rig: a device does not wait for the host."""


class EmulatorProcess:
    """Start one; it prints the drivers' options and then obeys.

    Args:
        devices: Which.
        settings: Of the emulated rig.
        priority: Its real-time priority, where it is allowed.
    """

    def __init__(self, *devices: str, settings: RigSettings | None = None, priority: int = 0) -> None:
        given = msgspec.json.encode(settings or RigSettings()).decode()
        self._process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "palp_core",
                "devices",
                "emulate",
                *devices,
                "--json",
                "--settings",
                given,
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        if priority:
            with suppress(PermissionError):
                os.sched_setscheduler(self._process.pid, os.SCHED_FIFO, os.sched_param(priority))
        self._lock = threading.Lock()
        self.options: dict[str, dict[str, Any]] = json.loads(self._line())

    def send(self, command: str) -> str:
        """Send a command and return its answer.

        Raises:
            RuntimeError: It was refused.
        """
        assert self._process.stdin is not None
        with self._lock:
            self._process.stdin.write(command + "\n")
            answer = self._line()
        if answer.startswith("error"):
            raise RuntimeError(f"emulator: {command}: {answer}")
        return answer

    def ask(self, command: str) -> Any:
        """Send a command and return its answer from JSON."""
        return json.loads(self.send(command))

    def close(self) -> None:
        """End the process."""
        self._process.communicate("quit\n", timeout=20)

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()


@contextmanager
def emulator(*devices: str, settings: RigSettings | None = None) -> Iterator[EmulatorProcess]:
    """Run emulated devices for a while."""
    rig = EmulatorProcess(*devices, settings=settings)
    try:
        yield rig
    finally:
        rig.close()


def host_words() -> str:
    """Describe the host and its load."""
    limits = Path("/proc/sys/kernel/sched_rt_runtime_us")
    share = limits.read_text(encoding="utf-8").strip() if limits.exists() else "?"
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    return (
        f"{os.cpu_count()} cores, Linux {platform.release()}, Python {platform.python_version()},"
        f" real-time share {share} us of a second, load before {load}"
    )
