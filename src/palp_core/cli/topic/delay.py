"""``palp topic delay``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from palp_core.cli.options import GraphOption, JsonOption, TopicsArgument, until_ctrl_c
from palp_core.cli.output import note, print_json, print_text
from palp_core.cli.running import find_graph, find_topics, note_ended
from palp_core.counted import counted

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import Edge

PERIOD_S = 1.0


def delay(
    topics: TopicsArgument,
    *,
    window: Annotated[
        int | None,
        typer.Option(
            "--window",
            "-w",
            metavar="N",
            min=1,
            max=10_000,
            help="Only the last N messages of each reader; default: all since it began.",
            show_default=False,
        ),
    ] = None,
    once: Annotated[bool, typer.Option("--once", help="One report, then end.")] = False,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """From the publisher's stamp to arrival, of every message since the reader began, or with -w of its last
    N: nothing is sampled, and this command is not in the way. A report each second, or a single one with
    --once or --json.
    """
    from threading import Event

    from palp_core.cli.topic.measure import readers

    running = find_graph(graph)
    entries = find_topics(running, topics)

    def report(accounts: dict[str, list[Edge]]) -> None:
        for name, edges in accounts.items():
            if as_json:
                print_json(
                    {
                        "topic": name,
                        "clock": running.record.clock,
                        "readers": [_latency_record(e) for e in edges],
                    }
                )
                continue
            if not edges:
                note(f"{name}: no node reads it, so nobody counts its latency")
            for edge in edges:
                print_text(f"{name} -> /{edge.node}: {_latency_text(edge.account)}")

    with until_ctrl_c():
        while True:
            report(readers(running, entries, window or 0))
            if once or as_json:
                return
            Event().wait(PERIOD_S)
            if not running.alive:
                note_ended(running)
                return


def _latency_s(account: dict[str, Any]) -> dict[str, Any] | None:
    """Return the latencies that were asked for, and of how many messages they are; None: there are none."""
    recent = account.get("recent_latency_s")
    if recent is not None:
        return recent if recent["messages"] else None
    latency_s = account.get("latency_s")
    return {"messages": account["received"], **latency_s} if latency_s else None


def _latency_record(edge: Edge) -> dict[str, Any]:
    latency_s = _latency_s(edge.account) or {"messages": 0, **dict.fromkeys(("p50", "p90", "p99", "max"))}
    messages = latency_s.pop("messages")
    told = {"node": f"/{edge.node}", "received": edge.account["received"]}
    return {**told, "messages": messages, "latency_s": latency_s}


def _latency_text(account: dict[str, Any]) -> str:
    latency_s = _latency_s(account)
    if latency_s is None:
        received = account["received"]
        return (
            f"{counted(received, 'message')}, all within an instant of simulated time"
            if received
            else "no message yet"
        )
    parts = [f"{name} {latency_s[name] * 1e3:.3f} ms" for name in ("p50", "p90", "p99", "max")]
    if "std" in latency_s:
        spread = [f"{name} {latency_s[name] * 1e3:.3f} ms" for name in ("mean", "std", "min")]
        return f"{' '.join(parts + spread)} of the last {latency_s['messages']} messages"
    return f"{' '.join(parts)} of {counted(latency_s['messages'], 'message')}"
