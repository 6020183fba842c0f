"""Graphs, viewers and browsers for a while, as a person has them: for measurements and pictures."""

from __future__ import annotations

import contextlib
import os
import shlex
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from palp_core.errors import GraphError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.running_graph import RunningGraph
from tests.support.palp import PATIENCE_S, Palp, own_palp
from tests.support.view.accounts import running_graph
from tests.support.view.browser import chromium, chromium_running

ROOT = Path(__file__).resolve().parents[1]
SIM, EMULATED = ROOT / "launch" / "sim.yaml", ROOT / "launch" / "emulated.yaml"
LENIENT = ("shared.stale_ms:=10000.0", "shared.beat_ms:=10000.0", "shared.link_ms:=20000.0", "answer_s:=20.0")
"""Of the emulated rig: a busy host is no fault of its devices."""


def until(so: Callable[[], object], what: str, patience_s: float = PATIENCE_S) -> None:
    """Wait until something is so.

    Raises:
        TimeoutError: It does not come.
    """
    pause, end_ns = threading.Event(), monotonic_ns() + round(patience_s * 1e9)
    while not so():
        if monotonic_ns() > end_ns:
            raise TimeoutError(f"no {what} within {patience_s:g} s")
        pause.wait(0.01)


def wait(seconds: float) -> None:
    """Let time go by."""
    threading.Event().wait(seconds)


class Launched:
    """A graph under way.

    Args:
        palp: The command line.
        folder: For what it writes and says.
        arguments: Of ``palp launch``.
    """

    def __init__(self, palp: Palp, folder: Path, *arguments: object) -> None:
        self.palp, self.folder = palp, folder
        self._output = (folder / "output.txt").open("w", encoding="utf-8")
        self.process = subprocess.Popen(
            palp.command("launch", *arguments),
            env=palp.environment, cwd=folder, stdout=self._output, stderr=self._output,
        )  # fmt: skip
        self._graph: RunningGraph | None = None
        until(self._at_work, "graph")

    @property
    def graph(self) -> RunningGraph:
        """The running graph."""
        assert self._graph is not None
        return self._graph

    def published(self, topic: str) -> int:
        """Return how many messages of a topic there were."""
        info = self.graph.ask(topic.split("/")[1], "info", timeout_s=30.0)
        return int(info["published"].get(topic, 0))

    def view(self, *options: str) -> subprocess.Popen[str]:
        """Start a viewer of it; what its pages record is left in the graph's folder."""
        with contextlib.chdir(self.folder):
            return self.palp.start("view", "--no-browser", "--graph", self.graph.record.id, *options)

    def _at_work(self) -> bool:
        if self.process.poll() is not None:
            raise GraphError((self.folder / "output.txt").read_text(encoding="utf-8"))
        try:
            self._graph = self._graph or running_graph(self.palp, "rig")
            return self.published("/torque/block") > 0
        except GraphError:
            return False


@contextmanager
def launched(*arguments: object) -> Iterator[Launched]:
    """Run a graph for a while; afterwards nothing of it is left."""
    with (
        tempfile.TemporaryDirectory(prefix="palp-view-", ignore_cleanup_errors=True) as name,
        own_palp() as palp,
    ):
        yield Launched(palp, Path(name), *arguments, f"out:={name}/out")


@contextmanager
def emulated(*arguments: str) -> Iterator[Launched]:
    """The emulated rig on the machine's clock: torque at 1 kHz, EMG at 1.5 kHz."""
    host = f"127.{os.getpid() >> 8 & 255}.{os.getpid() & 255}.11"
    with launched(EMULATED, f"host:={host}", "trials:=400", "training:=1", *LENIENT, *arguments) as found:
        yield found


@contextmanager
def browser(folder: Path) -> Iterator[Any]:
    """Chromium in what time the host has left, as if it were on another one."""
    script = folder / "chromium"
    script.write_text(
        f'#!/bin/sh\nexec nice -n 19 chrt -i 0 {shlex.quote(chromium())} "$@"\n', encoding="utf-8"
    )
    script.chmod(0o755)
    with chromium_running(str(script)) as found:
        yield found


def end(process: subprocess.Popen[str]) -> None:
    """End a process, and let go of its pipes."""
    process.kill()
    process.wait()
    for pipe in (process.stdout, process.stderr):
        if pipe is not None:
            pipe.close()
