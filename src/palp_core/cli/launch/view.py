"""What ``palp launch`` shows while a graph runs: each phase's progress, live score, speed."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

from palp_core.cli.output import escape_controls, note, own_stream, print_text
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.launch.run_journal import time_of_day
from palp_core.graph.messages.builtin import Progress

if TYPE_CHECKING:
    from palp_core.cli.launch.bars import Bars
    from palp_core.graph.description.checked import CheckedGraph
    from palp_core.graph.discovery.logs import LogLine
    from palp_core.graph.launch.run_journal import Incident

REDRAW_NS = 100_000_000
COLOURS = {"warning": "yellow", "error": "red"}
PLAIN_NS = 5_000_000_000


def show_log_line(line: LogLine) -> None:
    """Show a line of a node's log with the node's name; on a terminal, warnings in yellow, errors in red."""
    text = line.text if line.begins else f"[{line.node}]: {line.text}"
    note(text, COLOURS.get(line.level, ""))


class LaunchView:
    """Shows :class:`Progress` messages: bars on a terminal, a line every few seconds elsewhere."""

    def __init__(self) -> None:
        self._bars: Bars | None = None
        self._start_ns = monotonic_ns()
        self._next_ns = 0
        self._phase = ""
        self._lockstep = False

    @contextlib.contextmanager
    def showing(self, graph: CheckedGraph) -> Iterator[None]:
        self._start(graph)
        try:
            yield
        finally:
            if self._bars is not None:
                self._bars.stop()

    def _start(self, graph: CheckedGraph) -> None:
        self._start_ns = monotonic_ns()
        self._lockstep = graph.clock == "sim"
        if own_stream(sys.stdout).isatty():
            from palp_core.cli.launch.bars import Bars

            self._bars = Bars()
            self._bars.start()

    def show_progress(self, now_ns: int, _: str, progress: Progress) -> None:
        wall_ns = monotonic_ns()
        last = progress.done_count >= progress.total_count
        if wall_ns < self._next_ns and progress.phase == self._phase and not last:
            return
        self._next_ns = wall_ns + (REDRAW_NS if self._bars is not None else PLAIN_NS)
        self._phase = progress.phase
        self._show(progress, self._note(progress, now_ns, wall_ns))

    def _note(self, progress: Progress, now_ns: int, wall_ns: int) -> str:
        wall_s = max(wall_ns - self._start_ns, 1) / 1e9
        notes = [progress.text] if progress.text else []
        if progress.score_defined:
            notes.append(f"{100 * progress.score:.0f} % correct")
        if self._lockstep:
            notes.append(f"{now_ns / 1e9 / wall_s:.0f}x real time")
        return "  ".join(notes)

    def _show(self, progress: Progress, note: str) -> None:
        if self._bars is None:
            print_text(f"{progress.phase}: {progress.done_count}/{progress.total_count} {note}".rstrip())
            own_stream(sys.stdout).flush()
            return
        phase = escape_controls(progress.phase)
        self._bars.show(phase, progress.done_count, progress.total_count, escape_controls(note))

    def show_diagnostic(self, topic: str, incident: Incident | None) -> None:
        """Show what is wrong with a node for as long as it is; without a terminal print begin and end."""
        line = ""
        if incident is not None:
            advice = f" -> {incident.advice}" if incident.advice else ""
            line = f"{incident.at} /{incident.node}: {incident.text}{advice}"
        if self._bars is not None:
            self._bars.show_line(
                topic,
                escape_controls(line),
                "bold red" if incident and incident.level == "error" else "yellow",
            )
            return
        print_text(line or f"{time_of_day(0)} {topic}: ok again")
        own_stream(sys.stdout).flush()
