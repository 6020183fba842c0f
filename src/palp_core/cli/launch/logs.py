"""``palp logs``: what the nodes of a graph have printed."""

from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.options import GraphOption, OptionalNodeArgument, until_ctrl_c
from palp_core.cli.output import note, print_text
from palp_core.errors import GraphError


def logs(
    node: OptionalNodeArgument = None,
    *,
    lines: Annotated[int, typer.Option("-n", "--lines", min=0, help="How many of the last lines.")] = 50,
    follow: Annotated[bool, typer.Option("-f", "--follow", help="Go on until the run ends.")] = False,
    graph: GraphOption = None,
) -> None:
    """Show what nodes have printed: of all, with time and name, or of one, as it printed it.

    Of the running graph, or of the latest that left its logs: one that failed or was interrupted.
    """
    from palp_core.graph.discovery.log_reader import follow as following
    from palp_core.graph.discovery.run_directory import locked
    from palp_core.graph.supervision.logs import tail

    folder, log = _find(node, graph)
    said = tail(log, lines)
    for line in said:
        print_text(line)
    if not (said or follow or lines == 0):
        note(f"nothing was printed yet ({log})")
    if follow:
        with until_ctrl_c():
            for line in following(log, lambda: locked(folder)):
                print_text(line)


def _find(node: str | None, graph: str | None) -> tuple[Path, Path]:
    from palp_core.graph.discovery.choice import meant
    from palp_core.graph.discovery.run_directory import runs
    from palp_core.graph.node.spec import MERGED_LOG
    from palp_core.graph.problems import hint

    kept = runs()
    chosen = {record.id for record in meant([record for _, record, _ in kept], graph)}
    found = [(folder, record) for folder, record, _ in kept if record.id in chosen]
    if not found:
        what = f"no graph named '{graph}'" if graph else "no graph of this folder"
        raise GraphError(f"{what} is running or has left logs; start one with: palp launch FILE")
    folder, record = found[0]
    name = node.removeprefix("/") if node is not None else MERGED_LOG
    known = [entry.name for entry in record.nodes]
    if node is not None and name not in known:
        raise GraphError(f"no node '{node}' in graph '{record.graph}'{hint(name, known)}")
    log = folder / "log" / f"{name}.log"
    return folder, log if log.exists() else folder / "log" / "composition.log"
