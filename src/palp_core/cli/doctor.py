"""``palp doctor`` and ``palp top``: what is wrong, and how nodes and edges do."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from threading import Event
from typing import Annotated

import msgspec
import typer

from palp_core.cli.host import examine_host, examine_runs
from palp_core.cli.options import Call, GraphOption, JsonOption, graph_verb, option
from palp_core.cli.output import show, table_lines
from palp_core.cli.running import note_ended
from palp_core.counted import counted
from palp_core.graph.discovery.choice import choose, meant
from palp_core.graph.discovery.health import (
    EdgeRow,
    HealthReader,
    NodeRow,
    actions_as_one,
    rows,
    sample_health,
)
from palp_core.graph.discovery.run_directory import RunRecord, running
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.discovery.troubles import (
    ERROR,
    NOTE,
    OK,
    WARN,
    Trouble,
    active_diagnostics,
    examine_graph,
)

ASK_S = 2.0
_ORDER = (ERROR, WARN, NOTE, OK)
TOP_ASK_S = 0.5
HEALTH_TIMEOUT_S = 2.5
NODE_COLUMNS: dict[str, Callable[[NodeRow], str]] = {
    "NODE": lambda node: node.name,
    "STATE": lambda node: node.state if node.responsive else "SILENT",
    "CPU %": lambda node: _number(node.cpu_percent, 1),
    "MEMORY": lambda node: f"{node.memory_bytes / 1e6:.1f} MB",
    "RATE Hz": lambda node: _number(node.rate_hz, 1),
    "P99 ms": lambda node: _number(node.latency_p99_s, 3, 1e3),
    "LOST": lambda node: str(node.lost),
    "READERS LOST": lambda node: str(node.lost_by_readers),
    "OVERRUNS": lambda node: str(node.overruns),
    "MISSED": lambda node: str(node.missed_deadlines),
    "PID": lambda node: str(node.pid),
}
EDGE_COLUMNS: dict[str, Callable[[EdgeRow], str]] = {
    "TOPIC": lambda edge: edge.topic,
    "READER": lambda edge: edge.reader,
    "RATE Hz": lambda edge: _number(edge.rate_hz, 1),
    "RECEIVED": lambda edge: str(edge.received),
    "LOST": lambda edge: str(edge.lost),
    "REPEATED": lambda edge: str(edge.repeated),
    "LATE": lambda edge: str(edge.late),
    "DROPPED": lambda edge: str(edge.dropped),
    "P50 ms": lambda edge: _number(edge.latency_p50_s, 3, 1e3),
    "P99 ms": lambda edge: _number(edge.latency_p99_s, 3, 1e3),
    "MAX ms": lambda edge: _number(edge.latency_max_s, 3, 1e3),
}
Sample = tuple[list[NodeRow], list[EdgeRow], list[Trouble]]


def doctor(
    *,
    report: Annotated[bool, option("Also list passed checks.", "--report", "-r")] = False,
    include_warnings: Annotated[
        bool, option("Status 1 for warnings, too.", "--include-warnings", "-iw")
    ] = False,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Read-only. Status 1 if there is an error."""
    records, troubles = _graphs(graph)
    graphs = [
        (RunningGraph(record), f"graph {record.id}, " if len(records) > 1 else "") for record in records
    ]
    for one, place in graphs:
        troubles += [found.of_run(one.record.id, place) for found in active_diagnostics(one, ASK_S)]
    troubles += [*examine_host(), *examine_runs()]
    for one, place in graphs:
        troubles += [found.of_run(one.record.id, place) for found in examine_graph(one)]
    counts = {level: sum(trouble.level == level for trouble in troubles) for level in _ORDER}
    names = [record.graph for record in records]
    lines = _lines(troubles, counts, len(records), report=report)
    show({"graphs": names, **counts, "findings": troubles}, lines, as_json=as_json)
    if counts[ERROR] or (include_warnings and counts[WARN]):
        raise typer.Exit(1)


def _graphs(name: str | None) -> tuple[list[RunRecord], list[Trouble]]:
    """Return the graph that is named, or those of this folder, and a note on each that is left out."""
    if name is not None:
        return [choose(name).record], []
    records = running()
    chosen = meant(records, None)
    return chosen, [
        Trouble(
            f"graph {record.id}",
            NOTE,
            f"is another folder's, and not looked at: {record}",
            f"look at it: palp doctor --graph {record.id}",
        )
        for record in records
        if record not in chosen
    ]


def _lines(troubles: list[Trouble], counts: dict[str, int], graphs: int, *, report: bool) -> Iterator[str]:
    for trouble in sorted(troubles, key=lambda trouble: _ORDER.index(trouble.level)):
        if trouble.level != OK or report:
            yield f"{trouble.level.upper():<5} {trouble.where}: {trouble.text}"
            if trouble.advice:
                yield f"      -> {trouble.advice}"
    found = zip((ERROR, WARN, NOTE, OK), ("error", "warning", "note", "check"), strict=True)
    *bad, passed = (counted(counts[level], word) for level, word in found)
    yield f"{', '.join(bad)}; {passed} passed; {counted(graphs, 'graph')} running"


@graph_verb()
def top(
    call: Call,
    *,
    once: Annotated[bool, option("One sample, then end.", "--once")] = False,
    period: Annotated[float, option("Between samples.", "--period", "-d", min=0.1, metavar="S")] = 1.0,
) -> None:
    """RATE counts a node's timer ticks and the messages that it handled; READERS LOST is what the readers of
    its topics have lost for good. Below, each edge with its reader's own
    account; above, what nodes report as wrong. In a graph composed into one process, processor and memory are
    that process's.
    """
    running = call.graph
    samples = _samples(running, period)
    if call.as_json or once or not sys.stdout.isatty():
        sample = next(samples)
        named = zip(("nodes", "edges", "diagnostics"), sample, strict=True)
        call.show(
            {"graph": running.record.graph, "clock": running.record.clock, **dict(named)},
            (line for line, _ in _styled_lines(sample)),
        )
        return
    _show_live(running, samples)
    note_ended(running)


def _samples(graph: RunningGraph, period_s: float) -> Iterator[Sample]:
    """Yield a sample each period while the graph runs, from its health topic where that speaks."""
    reader = HealthReader(graph)
    try:
        before = reader.read(HEALTH_TIMEOUT_S) if graph.record.clock == "wall" else None
        by_topic = before is not None
        before = before or sample_health(graph)
        while graph.alive:
            if by_topic:
                after = reader.read(HEALTH_TIMEOUT_S)
            else:
                Event().wait(period_s)
                after = None
            by_topic = after is not None
            after = after or sample_health(graph)
            nodes, edges = rows(before, after)
            yield nodes, actions_as_one(edges), active_diagnostics(graph, TOP_ASK_S)
            before = after
    finally:
        reader.close()


def _tables(sample: Sample) -> tuple[list[list[str]], list[list[str]]]:
    """Return nodes and edges as rows of cells; a node's worst diagnostic takes the place of its state."""
    levels = {found.where: found.level.upper() for found in reversed(sample[2])}
    nodes = [msgspec.structs.replace(node, state=levels.get(node.name, node.state)) for node in sample[0]]
    return (
        [[column(node) for column in NODE_COLUMNS.values()] for node in nodes],
        [[column(edge) for column in EDGE_COLUMNS.values()] for edge in sample[1]],
    )


def _number(value: float | None, digits: int, scale: float = 1.0) -> str:
    return "-" if value is None else f"{value * scale:.{digits}f}"


def _styled_lines(sample: Sample) -> Iterator[tuple[str, str]]:
    """Yield each line of a sample, with its style."""
    troubled = {found.where for found in sample[2] if found.level == "error"}
    for found in sample[2]:
        advice = f" -> {found.advice}" if found.advice else ""
        yield f"{found.where}: {found.text}{advice}", "bold red" if found.level == "error" else "yellow"
    nodes, edges = _tables(sample)
    tables = [(list(NODE_COLUMNS), nodes), *([(list(EDGE_COLUMNS), edges)] if edges else [])]
    for titles, cells in tables:
        head, *lines = table_lines([titles, *cells])
        if cells is edges or sample[2]:
            yield "", ""
        yield head, "bold"
        for row, line in zip(cells, lines, strict=True):
            bad = "SILENT" in row or row[0] in troubled or row[titles.index("LOST")] != "0"
            yield line, "red" if bad else ""


def _show_live(graph: RunningGraph, samples: Iterator[Sample]) -> None:
    from rich.live import Live
    from rich.text import Text

    head = f"{graph.record.graph}  ({graph.record.clock} clock, process {graph.record.pid})   Ctrl-C ends"
    with Live(screen=True, auto_refresh=False) as live:
        for sample in samples:
            lines = ((f"{line}\n", style) for line, style in _styled_lines(sample))
            live.update(Text.assemble((f"{head}\n\n", "bold"), *lines, no_wrap=True), refresh=True)
