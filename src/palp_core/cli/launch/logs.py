"""``palp logs``: what the nodes of a graph have printed."""

from __future__ import annotations

from collections import deque
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from palp_core.cli import completion
from palp_core.cli.options import GraphOption, LevelOption, argument, option, until_ctrl_c
from palp_core.cli.output import note, print_text
from palp_core.errors import GraphError

if TYPE_CHECKING:
    from palp_core.graph.discovery.run_directory import RunRecord


def logs(
    node: Annotated[str | None, argument("Default: all.", "NODE", complete=completion.logged_nodes)] = None,
    *,
    lines: Annotated[int, option("How many of the last lines.", "-n", "--lines", min=0)] = 50,
    follow: Annotated[bool, option("Go on until the run ends.", "-f", "--follow")] = False,
    level: LevelOption = None,
    since: Annotated[
        str | None,
        option("Start time: 5m ago, 14:30, or a date and time.", metavar="TIME"),
    ] = None,
    graph: GraphOption = None,
) -> None:
    """Shows the running graph or an ended one; logs of the last 20 runs are kept. With --level or --since
    each line has time and name; what was printed without a level has none.
    """
    from palp_core.cli.values import since as time_of
    from palp_core.graph.discovery.logs import LineFilter, all_lines
    from palp_core.graph.discovery.logs import follow as following
    from palp_core.graph.node.spec import MERGED_LOG
    from palp_core.graph.supervision.logs import tail
    from palp_core.whole_file import is_locked

    folder, record, log = _find(node, graph)
    merged, name = log.with_name(f"{MERGED_LOG}.log"), "" if node is None else node.removeprefix("/")
    sought = LineFilter(name, level or "", time_of(since) if since is not None else None)
    as_it_is = level is None and since is None and log.exists()
    source = log if as_it_is else merged
    note(_header(record, source, lives=is_locked(folder)))
    shown = tail(log, lines) if as_it_is else deque(filter(sought.passes, all_lines(merged)), maxlen=lines)
    for line in shown:
        print_text(line)
    if not (shown or follow or lines == 0):
        note("nothing like that was printed" if level or since else "nothing was printed yet")
    if follow:
        with until_ctrl_c():
            for line in following(source, lambda: is_locked(folder)):
                if as_it_is or sought.passes(line):
                    print_text(line)


def _header(record: RunRecord, log: Path, *, lives: bool) -> str:
    began = datetime.fromtimestamp(record.start_unix_ns / 1e9, UTC).astimezone()
    state = "runs since" if lives else "is over; it began at"
    return (
        f"graph '{record.graph}' of {record.file}, id {record.id}, {state} {began:%Y-%m-%d %H:%M:%S} ({log})"
    )


def _find(node: str | None, graph: str | None) -> tuple[Path, RunRecord, Path]:
    from palp_core.graph.discovery.choice import meant
    from palp_core.graph.discovery.run_directory import runs
    from palp_core.graph.node.spec import MERGED_LOG
    from palp_core.graph.problems import hint

    kept = runs()
    chosen = {record.id for record in meant([record for _, record, _ in kept], graph)}
    found = [(not lives, folder, record) for folder, record, lives in kept if record.id in chosen]
    if not found:
        what = f"no graph named '{graph}'" if graph else "no graph of this folder"
        raise GraphError(f"{what} is running or has left logs; start one with: palp launch FILE")
    _, folder, record = min(found, key=lambda run: run[0])  # one that runs, then the latest
    name = node.removeprefix("/") if node is not None else MERGED_LOG
    known = [entry.name for entry in record.nodes]
    if node is not None and name not in known:
        raise GraphError(f"no node '{node}' in graph '{record.graph}'{hint(name, known)}")
    return folder, record, folder / "log" / f"{name}.log"
