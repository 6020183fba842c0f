"""Recorders that a page has started: processes of their own, ended as Ctrl-C ends ``palp bag record``.

What one says goes to a file without a name, not to a pipe: a viewer that is killed takes no recorder with it.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO

from palp_core.errors import BagError
from palp_core.graph.clock import unix_ns
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.view.source.operator import GraphOperator

IN_SIMULATED_TIME = (
    "a graph in simulated time cannot be recorded from here; "
    "launch it anew, with: palp launch FILE --record DIR"
)
NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,100}")
MOST = 8
"""Recorders of one viewer at a time."""
END_S = 60.0
MOST_BYTES = 64 << 10
"""Of what a recorder has said that is shown."""


class StartedRecorder:
    """One recorder.

    Args:
        process: It.
        said: The file into which it writes what it says.
        out: The bag.
        snapshot_s: It keeps so many seconds in memory; 0: it records at once.
    """

    def __init__(
        self, process: subprocess.Popen[bytes], said: IO[bytes], out: Path, snapshot_s: float
    ) -> None:
        self.out, self.snapshot_s = out, snapshot_s
        self._process, self._said = process, said

    @property
    def pid(self) -> int:
        """Of its process."""
        return self._process.pid

    @property
    def running(self) -> bool:
        """Whether it goes on."""
        return self._process.poll() is None

    @property
    def complete(self) -> bool | None:
        """Whether nothing is missing; None while it runs."""
        return None if self.running else self._process.returncode == 0

    @property
    def made(self) -> bool:
        """Whether there is a bag: a recorder that refuses makes none."""
        return self.out.exists()

    @property
    def words(self) -> list[str]:
        """What it has said: that it records, what it lacks, what became of it."""
        begin = max(os.fstat(self._said.fileno()).st_size - MOST_BYTES, 0)
        said = os.pread(self._said.fileno(), MOST_BYTES, begin).decode(errors="replace")
        return said.splitlines()

    def stop(self) -> None:
        """Let it end its bag, and wait until it has."""
        if self.running:
            self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            raise BagError(f"the recorder of {self.out} does not end; palp logs may tell why") from None


class Recordings:
    """All recorders of one viewer.

    Args:
        operator: Who may press what.
        folder: Where bags are made: nowhere else.
        palp: How ``palp`` is run.
    """

    def __init__(
        self, operator: GraphOperator, folder: Path, palp: Sequence[str] = (sys.executable, "-m", "palp_core")
    ) -> None:
        self._operator, self.folder, self._palp = operator, folder, palp
        self.all: list[StartedRecorder] = []
        self._one_at_a_time = threading.Lock()
        self._starter = ThreadPoolExecutor(1, "palp view: recorders")
        self._starter.submit(
            os.getpid
        ).result()  # its thread is there before pages give way to the graph's nodes

    @property
    def cannot(self) -> str:
        """Why nobody can record this graph from here, in words; "" if one can."""
        return IN_SIMULATED_TIME if self._operator.simulated else ""

    def start(self, name: str, topics: list[str], snapshot_s: float = 0.0) -> StartedRecorder:
        """Start a recorder.

        Args:
            name: Of the bag, in the folder; "": graph and time.
            topics: Which; none: all, the hidden ones too.
            snapshot_s: Keep so many seconds instead, and write them when asked.

        Raises:
            GraphError: It may not be pressed.
            BagError: The name is none, leads elsewhere, or is taken; there are many already; or the graph's
                time is simulated.
        """
        graph = self._operator.allow()
        if self.cannot:
            raise BagError(self.cannot)
        name = name or f"{graph.record.graph}-{unix_ns() // 10**9}"
        if NAME.fullmatch(name) is None:
            raise BagError(f"'{name}' is no name of a bag in {self.folder}; use letters, digits, _, - and .")
        out = self.folder / name
        with self._one_at_a_time:  # a double press is two requests at once, and a bag is not there at once
            if len([one for one in self.all if one.running]) >= MOST:
                raise BagError(f"{MOST} recorders are running; stop one")
            if any(one.out == out and one.running for one in self.all):
                raise BagError(f"{out} is being recorded already: choose another name")
            if out.exists():
                raise BagError(f"{out} exists already: choose another name")
            found = self._started(graph, out, topics, snapshot_s)
            self.all.append(found)
        return found

    def _started(
        self, graph: RunningGraph, out: Path, topics: list[str], snapshot_s: float
    ) -> StartedRecorder:
        options = ["--snapshot", str(snapshot_s)] if snapshot_s > 0 else []
        command = [*self._palp, "bag", "record", "--graph", graph.record.id, "-o", str(out), *options]
        said = tempfile.TemporaryFile()  # noqa: SIM115 - as long as somebody may look at it
        process = self._starter.submit(
            subprocess.Popen[bytes],
            [*command, "--", *topics] if topics else [*command, "--all"],
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        ).result()
        return StartedRecorder(process, said, out, snapshot_s)

    def snapshot(self) -> list[str]:
        """Let every recorder that keeps the last seconds write them; return what they say.

        Raises:
            GraphError: It may not be pressed.
            BagError: There is none, or one does not answer.
        """
        from palp_core.graph.recording.recorder_run import save_snapshots  # a tenth of what a viewer imports

        graph: RunningGraph = self._operator.allow()
        return save_snapshots(graph, signal.SIGUSR1)

    def stop(self, recording: StartedRecorder) -> StartedRecorder:
        """End one, and wait until its bag is whole; return it.

        Raises:
            GraphError: It may not be pressed.
            BagError: It does not end.
        """
        self._operator.allow(over=True)
        recording.stop()
        return recording

    def close(self) -> None:
        """End all of them: whoever closes the page leaves whole bags."""
        for one in self.all:
            if one.running:
                one.stop()
        self._starter.shutdown()
