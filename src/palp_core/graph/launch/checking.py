"""Check a launch file, and what only a start would find, without starting anything."""

import contextlib
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

from palp_core.graph.description.check import load
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.description.node_class import NodeClass
from palp_core.graph.discovery.run_directory import check_free
from palp_core.graph.launch.summary import RunSummary, report_function, summary_of
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.supervision.class_inspection import ToRun
from palp_core.graph.supervision.fork_server import ForkServer, fork_server
from palp_core.graph.swap.compatibility import incompatibilities, replaced


def succeed(checked: CheckedGraph, spec: NodeSpec, new_class: NodeClass) -> tuple[list[str], CheckedGraph]:
    """Return what speaks against a class in a node's place, and the graph with it there if nothing does."""
    wrong = incompatibilities(checked, spec, new_class)
    return wrong, checked if wrong else replaced(checked, spec, new_class, {})


def check_in(server: ForkServer, path: Path, overrides: Sequence[str], *, to_run: ToRun) -> CheckedGraph:
    """Check a launch file whose node classes children of a fork server import."""
    inspect = partial(server.inspect_classes, to_run=to_run)
    return load(path, overrides, inspect, succeed)


def check_file(path: str | Path, overrides: Sequence[str] = ()) -> CheckedGraph:
    """Check a launch file as a whole without starting anything.

    Raises:
        GraphProblems: Every problem of the file, each with its place.
    """
    alone = "palp_core.__main__" in sys.modules  # the command: one thread, and nothing of a workspace
    server = ForkServer(started=fork_server() if alone else None)
    try:
        return check_in(server, Path(path), overrides, to_run="nowhere")
    finally:
        server.close()


def check_start(
    path: str | Path, checked: CheckedGraph, name: str | None = None, *, resume: bool = False
) -> list[str]:
    """Check what only a start would find: that the name is free, and that the report has where to go.

    Returns what the launch file's report advises of such a run beforehand.

    Raises:
        PalpError: It would not start.
    """
    if name is not None:
        check_free(name)
    resumed_count = 0
    if resume:
        from palp_core.graph.launch.checkpoint import Checkpoints  # half of what this module would take

        with contextlib.closing(Checkpoints(checked, (), resume=True)) as checkpoints:
            resumed_count = checkpoints.resumed_count
    summary = summary_of(checked, Path(path), resumed_count=resumed_count)
    ask_report(checked, "prepare", summary)
    return list(ask_report(checked, "advise", summary) or ())


def ask_report(
    checked: CheckedGraph, stage: Literal["prepare", "advise", "attach", "begin"], summary: RunSummary
) -> Any:
    """Call the launch file's report at a stage before the run, if it has a function for that."""
    if not checked.report:
        return None
    function = getattr(report_function(checked.report, checked.workspace), stage, None)
    return None if function is None else function(summary)
