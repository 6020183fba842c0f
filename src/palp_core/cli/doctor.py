"""``palp doctor``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import msgspec
import typer

from palp_core.cli.host import examine_host, examine_runs
from palp_core.cli.options import GraphOption, JsonOption
from palp_core.cli.output import print_json, print_text
from palp_core.counted import counted
from palp_core.errors import GraphError
from palp_core.graph.discovery.choice import choose, line_of, meant
from palp_core.graph.discovery.health import HealthReader, rows, sample_of
from palp_core.graph.discovery.run_directory import RunRecord, running
from palp_core.graph.discovery.running_graph import Answers, RunningGraph
from palp_core.graph.discovery.troubles import (
    ERROR,
    NOTE,
    OK,
    WARN,
    Trouble,
    active_diagnostics,
    event_troubles,
    loss_troubles,
    node_troubles,
    qos_troubles,
)
from palp_core.graph.messages.builtin import EdgeHealth, GraphEvent, NodeEvent, NodeHealth
from palp_core.graph.messages.qos import Qos, incompatibility
from palp_core.graph.node.spec import LAUNCHER
from palp_core.graph.transport.requester_socket import ask

ASK_S = 2.0
HEALTH_S = 1.6
LONGEST_PAUSE_S = 0.005
MANY_UNREAD = 100
BEHIND_S = 1.0
"""Of its own rate, by which a reader has to be behind: nodes are not asked at the same instant."""
OVERRUNS_PART = 1e-4
EVENTS = "/graph/events"
_ORDER = (ERROR, WARN, NOTE, OK)


def doctor(
    *,
    report: Annotated[
        bool, typer.Option("--report", "-r", help="Also what was looked at and found in order.")
    ] = False,
    include_warnings: Annotated[
        bool, typer.Option("--include-warnings", "-iw", help="Status 1 for warnings, too.")
    ] = False,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """It only looks: a healthy run does not notice. Status 1 if there is an error."""
    records, troubles = _graphs(graph)
    graphs = [
        (RunningGraph(record), f"graph {record.id}, " if len(records) > 1 else "") for record in records
    ]
    for one, place in graphs:
        reported = active_diagnostics(one, ASK_S)
        troubles += [found.trouble.of_run(one.record.id, place) for found in reported]
    troubles += [*examine_host(), *examine_runs()]
    for one, place in graphs:
        troubles += [found.of_run(one.record.id, place) for found in examine_graph(one)]
    counts = {level: sum(trouble.level == level for trouble in troubles) for level in _ORDER}
    if as_json:
        print_json({"graphs": [record.graph for record in records], **counts, "findings": troubles})
    else:
        _print(troubles, counts, len(records), report=report)
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
            f"is another folder's, and not looked at: {line_of(record)}",
            f"look at it: palp doctor --graph {record.id}",
        )
        for record in records
        if record not in chosen
    ]


def _print(troubles: list[Trouble], counts: dict[str, int], graphs: int, *, report: bool) -> None:
    for trouble in sorted(troubles, key=lambda trouble: _ORDER.index(trouble.level)):
        if trouble.level == OK and not report:
            continue
        print_text(f"{trouble.level.upper():<5} {trouble.where}: {trouble.text}")
        if trouble.advice:
            print_text(f"      -> {trouble.advice}")
    print_text(
        f"{counted(counts[ERROR], 'error')}, {counted(counts[WARN], 'warning')}, "
        f"{counted(counts[NOTE], 'note')}; "
        f"{counted(counts[OK], 'check')} passed; {counted(graphs, 'graph')} running"
    )


def examine_graph(graph: RunningGraph) -> Iterator[Trouble]:
    """Yield what is wrong in a running graph, by the accounts that its own nodes keep."""
    where = f"graph {graph.record.graph}"
    answers = graph.ask_all("info", timeout_s=ASK_S)
    yield Trouble(where, OK, f"{len(answers.replies)} of {len(graph.node_names)} nodes answer")
    sample = sample_of(graph, answers)
    node_rows, edge_rows = rows(None, sample)
    yield from node_troubles(node_rows, sample.silent)
    for node in sample.nodes:
        yield from _overload(node)
    accounts = {(edge.topic, f"/{edge.node}"): edge.account for edge in answers.edges()}
    reliable = {edge for edge, account in accounts.items() if _reliable(account.get("qos", {}))}
    found = [
        *loss_troubles(edge_rows, reliable),
        *(trouble for node in sample.nodes for edge in node.edges for trouble in _edge(node, edge)),
        *_backlogs(answers, accounts),
        *_incompatible(answers, accounts),
    ]
    yield from found
    healthy = len(accounts) - len({trouble.where for trouble in found})
    if healthy:
        yield Trouble(where, OK, f"{healthy} edges with nothing lost, late or dropped")
    for name, info in answers.replies.items():
        topic = f"/{name}/_events"
        if info.get("published", {}).get(topic, 0):
            try:
                yield from qos_troubles(name, graph.decoded_history(name, topic, NodeEvent, ASK_S))
            except GraphError:
                continue
    try:
        yield from event_troubles(graph.decoded_history(LAUNCHER, EVENTS, GraphEvent, ASK_S))
    except GraphError as problem:
        yield Trouble(where, ERROR, f"its launcher: {problem}", "is it stopped or stuck?")
    yield from _pauses(graph)
    yield from _refusals(graph)


def _overload(node: NodeHealth) -> Iterator[Trouble]:
    name, ticks = f"/{node.node}", max(node.tick_count, 1)
    if node.overrun_count:
        yield Trouble(
            name,
            WARN if node.overrun_count / ticks > OVERRUNS_PART else NOTE,
            f"{node.overrun_count} of {ticks} ticks began after the next was due",
            "lower its rate, shorten its handlers, or give it cores and realtime_priority in the launch file",
        )
    if node.rejected_count:
        yield Trouble(
            name,
            WARN,
            f"{counted(node.rejected_count, 'frame was', 'frames were')} refused as malformed or of "
            "another type",
            "its log names them; was a node rebuilt with another message type while the graph ran?",
        )
    if node.unread_count > MANY_UNREAD:
        yield Trouble(name, WARN, _waiting(node.unread_count), "its handlers are too slow for its inputs")


def _waiting(count: int) -> str:
    return f"{counted(count, 'message waits', 'messages wait')} to be read"


def _reliable(requested: dict[str, Any]) -> bool:
    return bool(requested.get("reliability", "reliable") == "reliable")


def _edge(node: NodeHealth, edge: EdgeHealth) -> Iterator[Trouble]:
    where = f"{edge.topic} -> /{node.node}"
    if edge.late_count:
        text = f"{counted(edge.late_count, 'message')} late, of {edge.received_count}"
        yield Trouble(where, WARN, text, "see palp topic delay, and the load of the cores")
    if edge.dropped_count:
        yield Trouble(
            where,
            WARN,
            f"{counted(edge.dropped_count, 'message')} dropped unread: past the lifespan, or beyond the "
            "reader's depth",
            "the reader is too slow for this topic, or its depth too small",
        )
    if edge.repeated_count:
        text = f"{counted(edge.repeated_count, 'message')} came more than once, handed over once"
        yield Trouble(where, NOTE, text)


def _backlogs(answers: Answers, accounts: dict[tuple[str, str], dict[str, Any]]) -> Iterator[Trouble]:
    """Count what is on its way or waits, most of it in sockets, which no node can count."""
    published: dict[str, int] = {}
    for info in answers.replies.values():
        published |= info.get("published", {})
    for (topic, reader), account in accounts.items():
        sequence = published.get(topic, 0)
        behind = sequence - account.get("sequence", sequence)
        has_begun = account.get("epoch", 0) >= 0
        if has_begun and behind > max(MANY_UNREAD, BEHIND_S * (account.get("rate_hz") or 0.0)):
            advice = "the reader's handlers are too slow for it; history: keep_all makes the publisher wait"
            yield Trouble(f"{topic} -> {reader}", WARN, _waiting(behind), advice)


def _incompatible(answers: Answers, accounts: dict[tuple[str, str], dict[str, Any]]) -> Iterator[Trouble]:
    offered: dict[str, Any] = {
        topic: output.get("qos", {})
        for info in answers.replies.values()
        for topic, output in info.get("outputs", {}).items()
    }
    for (topic, reader), account in accounts.items():
        if account.get("qos") and offered.get(topic):
            reason = incompatibility(
                msgspec.convert(account["qos"], Qos), msgspec.convert(offered[topic], Qos)
            )
            if reason is not None:
                text = f"quality of service: {reason}"
                yield Trouble(f"{topic} -> {reader}", ERROR, text, "change one of the two")


def _pauses(graph: RunningGraph) -> Iterator[Trouble]:
    if graph.record.clock != "wall":
        return
    reader = HealthReader(graph)
    try:
        health = reader.read(HEALTH_S)
    finally:
        reader.close()
    for node in health.nodes if health is not None else ():
        name = f"/{node.node}"
        text = (
            f"{counted(node.gc_pause_count, 'pause')} of the garbage collector, the longest "
            f"{node.gc_pause_max_s * 1e3:.1f} ms"
        )
        if node.gc_pause_max_s > LONGEST_PAUSE_S:
            advice = "make fewer objects that refer to each other in its handlers"
            yield Trouble(name, WARN, text, advice)
        else:
            yield Trouble(name, OK, text)
        if node.missed_deadline_count:
            text = f"{counted(node.missed_deadline_count, 'deadline')} of its inputs missed"
            yield Trouble(name, WARN, text, "palp topic info on its inputs shows which")


def _refusals(graph: RunningGraph) -> Iterator[Trouble]:
    path = graph.folder / "gateway.srv"
    if not path.exists():
        return
    reply = ask(f"ipc://{path}", {"op": "refusals"}, ASK_S)
    if reply is None or "error" in reply:
        yield Trouble("gateway", ERROR, "does not answer", f"see {graph.folder / 'log'}")
        return
    for refusal in reply.get("refusals", []):
        often = f", {refusal['count']} times" if refusal.get("count", 1) > 1 else ""
        key = f" with key {refusal['key']}" if refusal.get("key") else ""
        text = f"refused {refusal.get('address') or 'somebody'}{key}{often}: {refusal['reason']}"
        yield Trouble("gateway", WARN, text, "palp keys list shows who is allowed")
