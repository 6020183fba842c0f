"""The end of a running graph, asked for from elsewhere: as Ctrl-C at its launch does it."""

from __future__ import annotations

import os
import select
import signal
from contextlib import suppress
from typing import Self

from palp_core.errors import GraphError
from palp_core.graph.discovery.run_directory import END_ASKED
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.whole_file import write_whole


class EndingGraph:
    """A graph that has been asked to end; close it, or use it in a ``with``."""

    def __init__(self, process: int) -> None:
        self._process = process

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def wait(self, timeout_s: float) -> bool:
        """Wait until the launcher's process has ended; tell whether it has."""
        waiting = select.poll()  # select.select() takes no descriptor above 1023
        waiting.register(self._process, select.POLLIN)
        return bool(waiting.poll(timeout_s * 1e3))

    def close(self) -> None:
        os.close(self._process)


def ask_to_end(graph: RunningGraph, asked_by: str) -> EndingGraph:
    """Ask a graph to end: its launcher brings every node to its safe state, and ends."""
    record = graph.record
    ended = f"graph '{record.graph}' has ended already"
    try:
        process = os.pidfd_open(record.pid)
    except OSError as error:
        raise GraphError(ended) from error
    try:
        if not graph.alive:  # asked once the process is held: its number cannot be another's from here on
            raise GraphError(ended)
        with suppress(OSError):  # a full disk: then it only knows of the signal
            write_whole(graph.folder / END_ASKED, asked_by)
        signal.pidfd_send_signal(process, signal.SIGINT)
    except BaseException as error:
        os.close(process)
        if isinstance(error, OSError):
            why = f"graph '{record.graph}' (pid {record.pid}) cannot be asked to end: {error.strerror}"
            raise GraphError(why) from error
        raise
    return EndingGraph(process)
