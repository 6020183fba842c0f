"""``palp topic delay``."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from palp_core.cli.options import GraphOption, JsonOption, TopicsArgument, until_ctrl_c
from palp_core.cli.output import note, print_json, print_text

__all__ = ["delay"]

PERIOD_S = 1.0


def delay(
    topics: TopicsArgument,
    *,
    once: Annotated[bool, typer.Option("--once", help="One report, then end.")] = False,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Tell the latency that readers have counted.

    From the publisher's stamp to arrival, of every message since the reader began: nothing is sampled, and
    this command is not in the way. A report each second, or a single one with --once or --json.
    """
    from threading import Event

    from palp_core.cli.measure import readers
    from palp_core.launch.remote import Edge, RunningGraph

    running = RunningGraph.find(graph)
    entries = list({name: running.topic(name) for name in topics}.values())

    def report(accounts: dict[str, list[Edge]]) -> None:
        for name, edges in accounts.items():
            if as_json:
                print_json(
                    {"topic": name, "clock": running.record.clock, "readers": [_told(e) for e in edges]}
                )
                continue
            if not edges:
                note(f"{name}: no node reads it, so nobody counts its latency")
            for edge in edges:
                print_text(f"{name} -> /{edge.node}: {_in_words(edge.account)}")

    with until_ctrl_c():
        while True:
            report(readers(running, entries))
            if once or as_json:
                return
            Event().wait(PERIOD_S)
            if not running.alive:
                note(f"graph '{running.record.graph}' has ended")
                return


def _told(edge: Any) -> dict[str, Any]:
    latency_s = edge.account.get("latency_s") or dict.fromkeys(("p50", "p90", "p99", "max"))
    return {"node": f"/{edge.node}", "received": edge.account["received"], "latency_s": latency_s}


def _in_words(account: dict[str, Any]) -> str:
    latency_s = account.get("latency_s")
    if not latency_s:
        received = account["received"]
        return (
            f"{received} messages, all within an instant of simulated time" if received else "no message yet"
        )
    parts = [f"{name} {latency_s[name] * 1e3:.3f} ms" for name in ("p50", "p90", "p99", "max")]
    return " ".join(parts) + f" of {account['received']} messages"
