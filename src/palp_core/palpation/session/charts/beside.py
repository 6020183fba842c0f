"""Charts drawn by a second process: it loads what draws while a run goes on, then draws every other one.

Run as ``python -m palp_core.palpation.session.charts.beside <process id of the launcher>``. It waits for the
folder of the session on its standard input, and ends when that closes; it dies with the launcher.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from palp_core.graph.process.parent_death import die_with_parent
from palp_core.graph.supervision.fork_start import ONE_THREAD, SHARES_CORES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from palp_core.graph.launch.summary import RunSummary

WORTH_TRIALS = 50
"""Trials a phantom from which on a composed run outlasts the loading of what draws."""


def worth_it(summary: RunSummary) -> bool:
    """Tell whether a run is long enough, and there is a core that it leaves alone."""
    trials = summary.args.get("trials", 0)
    return (
        summary.composed
        and isinstance(trials, int)
        and trials >= WORTH_TRIALS
        and len(os.sched_getaffinity(0)) > 1
        and SHARES_CORES not in os.environ
    )


class ChartsBeside:
    """The second process, started at once. Closing it ends it; what it has not drawn is then drawn here."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", __name__, str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,  # what goes wrong there is done again here, and said
            env={**os.environ, **ONE_THREAD},
            start_new_session=True,
        )

    def begin(self, folder: Path) -> None:
        """Let it draw its charts of the session in a folder, whose result has been written."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError, ValueError):  # it is gone
            self._process.stdin.write(os.fsencode(folder.absolute()))
            self._process.stdin.close()

    def finished(self) -> bool:
        """Wait for it; tell whether it has drawn all of its charts."""
        return self._process.wait() == 0

    def close(self) -> None:
        """End it."""
        self._process.kill()
        self._process.wait()
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()


def _draw_words(figure: Figure) -> None:
    """Draw what makes fonts and the reader of formulas load."""
    figure.subplots().set_title("$x$")


def main(parent: int) -> None:
    """Load what draws, wait for the folder, draw."""
    die_with_parent(parent)
    from palp_core.palpation.reporting.charts import Chart, images, save
    from palp_core.palpation.session.charts.of_session import charts_of

    images(Chart("", "", "", 1.0, (), (), _draw_words))
    folder = Path(os.fsdecode(sys.stdin.buffer.read()))
    if folder.name:
        for chart in charts_of(folder)[1::2]:
            save(chart, folder / "charts")


if __name__ == "__main__":
    main(int(sys.argv[1]))
