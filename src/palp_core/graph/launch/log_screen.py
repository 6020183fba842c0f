"""Lines of a run's log as they come, for the terminal; on a thread: a slow terminal holds up no graph."""

import contextlib
import os
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from palp_core.counted import counted
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.choice import addressed
from palp_core.graph.discovery.logs import RANK, LineReader, LogLine, follow
from palp_core.graph.log_format import ENDS_NODE
from palp_core.graph.supervision.logs import LogLevels, levels_of

MOST_PER_S = 100
"""Lines shown of a second; the others are counted (assumed: no person reads faster)."""

SECOND_NS = 1_000_000_000
LAST_WORDS_S = 2.0
"""How long the end of a run waits for a terminal that takes nothing."""

Show = Callable[[LogLine], None]


class Shown:
    def __init__(self, level: str | LogLevels, outputs: Mapping[str, str], show: Show, run: str = "") -> None:
        self._run = run
        self._levels, self._outputs, self._show = levels_of(level), outputs, show
        self._reader = LineReader()
        self._ended: set[str] = set()
        self._end_ns = self._count = 0

    def take(self, text: str) -> None:
        line = self._reader.read(text)
        if not self._is_wanted(line):
            return
        if monotonic_ns() > self._end_ns:
            self.flush()
            self._end_ns = monotonic_ns() + SECOND_NS
        self._count += 1
        if self._count <= MOST_PER_S:
            self._show(line)

    def _is_wanted(self, line: LogLine) -> bool:
        if line.begins and line.level == "critical" and line.text.endswith(ENDS_NODE):
            self._ended.add(line.node)
        elif line.begins or line.level != "critical":
            self._ended.discard(line.node)
        if "[supervisor]: " in line.text or line.node in self._ended:
            return False
        return self._outputs.get(line.node) == "screen" or (
            line.begins and RANK[line.level] >= RANK[self._levels.shown(line.node)]
        )

    def flush(self) -> None:
        """Say how many lines were too many."""
        if self._count > MOST_PER_S:
            text = f"... and {counted(self._count - MOST_PER_S, 'more line')}: " + addressed(
                "palp logs", self._run
            )
            self._show(LogLine("", "", "warning", True, text))
        self._count = 0


@contextlib.contextmanager
def showing_log(log: Path, shown: Shown) -> Iterator[None]:
    """Show lines of a log, from its first on, until the end; then what is left of them."""
    ended = threading.Event()
    wake = os.eventfd(0, os.EFD_CLOEXEC)

    def read() -> None:
        for line in follow(log, lambda: not ended.is_set(), begin=True, wake=wake):
            shown.take(line)
        shown.flush()

    reader = threading.Thread(target=read, name="palp-log-screen", daemon=True)
    reader.start()
    try:
        yield
    finally:
        ended.set()
        os.eventfd_write(wake, 1)
        reader.join(LAST_WORDS_S)
        if not reader.is_alive():
            os.close(wake)
