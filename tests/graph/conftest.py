"""Run ``palp`` as a user does, and find every process that it leaves behind."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from palp_core.runtime.clock import monotonic_ns

ROOT = Path(__file__).parents[2]
CHAIN = ROOT / "examples/chain/launch/chain.yaml"
SIM = ROOT / "launch/sim.yaml"
PATIENCE_S = 120.0


class Palp:
    """The command line in an environment of its own, whose processes carry a mark."""

    def __init__(self, runtime_dir: Path) -> None:
        self._started: list[subprocess.Popen[str]] = []
        self.mark = uuid.uuid4().hex
        self.runtime_dir = runtime_dir
        self.environment = {
            **os.environ,
            "XDG_RUNTIME_DIR": str(runtime_dir),
            "PALP_TEST_MARK": self.mark,
            "PYTHONUNBUFFERED": "1",
            "PYTHONPATH": str(ROOT / "src"),
            "COLUMNS": "200",
        }

    def command(self, *arguments: object) -> list[str]:
        return [sys.executable, "-m", "palp_core", *map(str, arguments)]

    def run(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            self.command(*arguments),
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )

    def start(self, *arguments: object) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            self.command(*arguments),
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._started.append(process)
        return process

    def close(self) -> None:
        """Leave nothing behind, whatever the test did."""
        for process in self.processes():
            with contextlib.suppress(psutil.Error):
                process.kill()
        for started in self._started:
            started.wait()
            for pipe in (started.stdout, started.stderr):
                if pipe is not None:
                    pipe.close()

    def processes(self) -> list[psutil.Process]:
        """Every living process that carries the mark."""
        found = []
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error):
                if process.environ().get("PALP_TEST_MARK") == self.mark and (
                    process.status() != psutil.STATUS_ZOMBIE
                ):
                    found.append(process)
        return found

    def all_gone_within(self, seconds: float) -> bool:
        """Wait for the end of every marked process; tell whether it came in time."""
        end_ns = monotonic_ns() + round(seconds * 1e9)
        while alive := self.processes():
            if monotonic_ns() > end_ns:
                return False
            psutil.wait_procs(alive, timeout=0.02)  # a zombie that init has yet to reap counts as gone
        return True


def wait_for_line(process: subprocess.Popen[str], start: str) -> None:
    """Read what a process says until a line begins like that."""
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(start):
            return
    raise AssertionError(f"ended before '{start}': {process.stderr.read() if process.stderr else ''}")


@pytest.fixture
def palp(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Palp]:
    command = Palp(tmp_path_factory.mktemp("r"))
    yield command
    command.close()
