"""Which of the running graphs a command is about: the one that is named, or that of the folder one is in.

A graph belongs to its workspace and to the folder from which it was launched; a folder with ``nodes/``, as a
checkout has, stands for those in it. Another folder's graph is never meant unless it is named.
"""

from collections.abc import Sequence
from typing import NamedTuple

from palp_core.errors import GraphError
from palp_core.graph.discovery.run_directory import RunRecord, present_folder, running
from palp_core.graph.problems import hint

START_ONE = "start one with: palp launch FILE; if you just started one, wait and try again"


class WhichGraph(GraphError):
    """Graphs are running, and it is not clear which of them is meant."""

    def __init__(self, what: str, records: Sequence[RunRecord]) -> None:
        lines = "\n".join(f"  {record}" for record in records)
        super().__init__(f"{what}; name one with --graph NAME, ID or PID:\n{lines}")


class ChosenGraph(NamedTuple):
    """The graph that is meant, and the others that run."""

    record: RunRecord
    others: list[RunRecord]


def belongs(record: RunRecord, folder: str) -> bool:
    """Tell whether a graph is one of a folder, as :func:`present_folder` returns it."""
    return bool(folder) and folder in (record.workspace, record.launched_from)


def choose(name: str | None = None, *, sole: bool = True) -> ChosenGraph:
    """Return the running graph of this user that is meant; if not ``sole``, the latest of several."""
    known = running()
    found = meant(known, name)
    if not known:
        what = f"no graph named '{name}' is running" if name else "no graph is running"
        raise GraphError(f"{what}; {START_ONE}")
    if name is not None and not found:
        names = {word for record in known for word in (record.graph, record.id)}
        raise GraphError(f"no graph named '{name}' is running{hint(name, names)}; see: palp graph list")
    if not found:
        here = f"no graph of this folder ({present_folder()}; one may still be starting)"
        raise WhichGraph(f"{here} is running, but elsewhere", known)
    if len(found) > 1 and sole:
        what = f"graphs named '{name}'" if name else "graphs"
        raise WhichGraph(f"{len(found)} {what} are running, so nothing was done", found)
    certain = name is not None and len(found) == 1
    return ChosenGraph(found[0], [] if certain else [record for record in known if record is not found[0]])


def meant(records: Sequence[RunRecord], name: str | None) -> list[RunRecord]:
    """Return those that a name, id or pid names, or those of this folder if there is none."""
    if name is None:
        here = present_folder()
        return [record for record in records if belongs(record, here)]
    return [record for record in records if name in (record.graph, record.id, str(record.pid))]


def addressed(command: str, run: str) -> str:
    """Return a command of palp about a run, with the run's id if another runs; "" remains."""
    if not command or not run or all(record.id == run for record in running()):
        return command
    return f"{command} --graph {run}"


def addressed_advice(advice: str, run: str) -> str:
    """Return what a node advises; the command of palp that it ends in is :func:`addressed`."""
    text, palp, rest = advice.rpartition("palp ")
    return text + addressed(palp + rest, run) if palp else advice
