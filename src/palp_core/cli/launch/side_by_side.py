"""Several ``palp launch`` at a time, each a process of its own, with their progress in one place."""

from __future__ import annotations

import contextlib
import os
import re
import selectors
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

from palp_core.cli.output import print_text
from palp_core.graph.supervision.fork_child import die_with_parent
from palp_core.graph.supervision.interrupt import Interrupt

if TYPE_CHECKING:
    from palp_core.cli.launch.bars import Bars

LAST_LINES = 5
_PROGRESS = re.compile(r"([^:]+): (\d+)/(\d+) ?(.*)")


class Launched:
    """A ``palp launch`` under way.

    Args:
        words: What follows ``palp launch``.

    Attributes:
        last: Its last lines that are no progress.
    """

    def __init__(self, words: Sequence[str]) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "palp_core", "launch", *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONHASHSEED": "0"},
            start_new_session=True,  # Ctrl-C reaches it by the launcher of all, once
            preexec_fn=partial(die_with_parent, os.getpid()),  # it only calls prctl
        )
        assert self.process.stdout is not None
        self.output = self.process.stdout
        os.set_blocking(self.output.fileno(), False)
        self.last: deque[str] = deque(maxlen=LAST_LINES)
        self._rest = b""

    def lines(self) -> Iterator[str]:
        """Yield what it has said since; at its end what is left of it."""
        data = self.output.read()
        *lines, self._rest = (self._rest + (data or b"")).split(b"\n")
        if data == b"" and self._rest:
            lines, self._rest = [*lines, self._rest], b""
        for line in lines:
            yield line.decode(errors="replace")

    @property
    def ended(self) -> bool:
        return self.process.poll() is not None


class SideBySideView:
    """Shows how far each run is: a bar each on a terminal, lines elsewhere.

    Args:
        count: How many runs there are.
    """

    def __init__(self, count: int) -> None:
        self._count, self._done = count, 0
        self._bars: Bars | None = None

    @contextlib.contextmanager
    def showing(self) -> Iterator[None]:
        """Show; afterwards the terminal is as it was."""
        if not sys.stdout.isatty():
            yield
            return
        from palp_core.cli.launch.bars import Bars

        self._bars = Bars()
        with self._bars:
            yield

    def show_line(self, run: Launched, name: str, line: str) -> None:
        """Show a line of a run if it tells how far it is; keep any other."""
        found = _PROGRESS.fullmatch(line)
        if found is None:
            run.last.append(line)
            return
        phase, done, total, words = found.groups()
        if self._bars is not None:
            self._bars.show(name, int(done), int(total), f"{phase}, {words}".rstrip(", "))
        else:
            print_text(f"{name}: {line}")
            sys.stdout.flush()

    def ended(self, name: str, status: int) -> None:
        self._done += 1
        words = "whole" if status == 0 else "ended early"
        if self._bars is not None:
            self._bars.show("runs", self._done, self._count, "")
        else:
            print_text(f"{name}: {words}, {self._done} of {self._count} runs")
            sys.stdout.flush()


def run_side_by_side(commands: Mapping[str, Sequence[str]], workers: int) -> dict[str, str]:
    """Launch several graphs, so many at a time; return what those said last that failed, by name.

    Args:
        commands: What follows ``palp launch``, by a name for each.
        workers: How many go on at a time.

    Raises:
        Interrupted: The end was asked for; every one has ended, in order.
    """
    waiting, failed = deque(commands), {}
    running: dict[str, Launched] = {}
    view = SideBySideView(len(commands))
    with Interrupt() as interrupt, selectors.DefaultSelector() as ready, view.showing():
        ready.register(interrupt.descriptor, selectors.EVENT_READ)
        while waiting or running:
            while waiting and len(running) < workers:
                name = waiting.popleft()
                running[name] = Launched(commands[name])
                ready.register(running[name].output, selectors.EVENT_READ, name)
            for key, _ in ready.select(1.0):
                if key.data is None:  # asked to end: each comes to its end, and none begins
                    interrupt.drain()
                    waiting.clear()
                    for run in running.values():
                        run.process.send_signal(signal.SIGINT)
                    continue
                run = running[key.data]
                for line in run.lines():
                    view.show_line(run, key.data, line)
            for name, run in [(name, run) for name, run in running.items() if run.ended]:
                for line in run.lines():
                    view.show_line(run, name, line)
                ready.unregister(run.output)
                run.output.close()
                del running[name]
                view.ended(name, run.process.returncode)
                if run.process.returncode:
                    failed[name] = " | ".join(run.last) or f"it ended with status {run.process.returncode}"
        interrupt.check()
    return failed
