"""The bars of the launch view on a terminal, and the lines below them."""

import sys
from collections.abc import Iterable

from rich.console import Console, RenderableType
from rich.file_proxy import FileProxy
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.text import Text

from palp_core.cli.output import own_stream


class Bars(Progress):
    """A bar per phase; while a node reports a fault, that too, and the bars' time stops."""

    def __init__(self) -> None:
        self._lines: dict[str, Text] = {}
        self._phases: dict[str, TaskID] = {}
        of_nodes = [stream for stream in (sys.stdout, sys.stderr) if hasattr(stream, "launcher_stream")]
        super().__init__(
            TextColumn("{task.description:<12}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}", markup=False),
            TimeElapsedColumn(),
            console=Console(file=own_stream(sys.stdout)),
            redirect_stdout=not of_nodes,
            redirect_stderr=not of_nodes,
        )
        for stream in of_nodes:  # what palp itself writes is above the bars
            stream.launcher_stream = FileProxy(self.console, stream.launcher_stream)

    def get_renderables(self) -> Iterable[RenderableType]:
        yield from super().get_renderables()
        yield from list(self._lines.values())

    def show(self, phase: str, done: int, total: int, note: str) -> None:
        if phase not in self._phases:
            self._phases[phase] = self.add_task(phase, total=total, note=note)
        self.update(self._phases[phase], completed=done, total=total, note=note)

    def show_line(self, key: str, line: str, style: str) -> None:
        """Show a line at once, until another or none ("") of that key comes."""
        self._lines.pop(key, None)
        if line:
            self._lines[key] = Text(line, style=style)
        for task in self.tasks:  # a stopped task's time stops; it goes on as if it had not
            if self._lines and task.stop_time is None:
                self.stop_task(task.id)
            elif not self._lines and not task.finished:
                task.stop_time = None
        self.refresh()
