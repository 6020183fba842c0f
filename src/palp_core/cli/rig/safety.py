"""``palp safety`` and ``palp stop``: the state of the safety node, stopping, and acknowledging a trip."""

import sys
from typing import Annotated, Any

import typer

from palp_core.cli.launch.stop_key import call_safety, stop_motion, stopped_text
from palp_core.cli.options import Call, graph_verb, option
from palp_core.cli.output import note, print_json, print_text
from palp_core.errors import GraphError

app = typer.Typer()


@graph_verb(timeout_s=5.0, changes=True)
def stop(
    call: Call,
    *,
    every: Annotated[bool, option("Of every graph of this user, whatever its folder.", "--all")] = False,
) -> None:
    """It stays stopped until ``palp safety ack``."""
    from palp_core.graph.discovery.choice import WhichGraph

    if every and call.name is not None:
        raise GraphError("--all stops every graph: leave out --graph, or leave out --all")
    if every:
        _stop_all(call)
        return
    try:
        reply = stop_motion(call.graph, "palp stop", call.timeout_s)
    except WhichGraph as error:
        raise GraphError(f"{error}\nor stop all of them: palp stop --all") from None
    call.show(reply, [stopped_text(reply, call.graph.record.id)])


def _stop_all(call: Call) -> None:
    """Stop all graphs at the same time, so that a silent one holds up none; status 2 if one was not."""
    from concurrent.futures import ThreadPoolExecutor

    from palp_core.graph.discovery.choice import START_ONE
    from palp_core.graph.discovery.run_directory import RunRecord, running
    from palp_core.graph.discovery.running_graph import RunningGraph

    def stopped(record: RunRecord) -> dict[str, Any] | GraphError:
        try:
            return stop_motion(RunningGraph(record), "palp stop --all", call.timeout_s)
        except GraphError as error:
            return error

    records = running()
    if not records:
        raise GraphError(f"no graph is running; {START_ONE}")
    with ThreadPoolExecutor(max_workers=len(records)) as pool:
        answers = list(zip(records, pool.map(stopped, records), strict=True))
    replies = {record.id: reply for record, reply in answers if isinstance(reply, dict)}
    if call.as_json:
        print_json(replies)
    for record, answer in answers:
        if isinstance(answer, GraphError):
            note(f"{record}: {answer}")
        elif not call.as_json:
            again = f"when all is well: palp safety ack --graph {record.id}"
            print_text(f"{record}: {answer['state']}: {answer['cause']}; {again}")
    if len(replies) < len(records):
        sys.exit(2)


def checks_table(checks: list[dict[str, Any]], now_ns: int) -> str:
    """Return a line for each check: what was verified, how long ago, and what was not.

    >>> link = {"name": "own link, y", "verified_ns": 1_000_000_000, "text": "followed the stage over 3.0 mm"}
    >>> button = {"name": "emergency stop", "verified_ns": 0, "text": "no software can see it"}
    >>> print(checks_table([button, link], 3_500_000_000))
    verified:
      own link, y     2.5 s ago: followed the stage over 3.0 mm
    not verified:
      emergency stop  no software can see it
    """
    width = max(len(check["name"]) for check in checks)
    lines = {True: ["verified:"], False: ["not verified:"]}
    for check in checks:
        seen_ns = check["verified_ns"]
        ago = f"{max(0.0, (now_ns - seen_ns) * 1e-9):.1f} s ago: " if seen_ns else ""
        lines[seen_ns > 0].append(f"  {check['name']:{width}}  {ago}{check['text']}")
    return "\n".join(line for part in lines.values() if len(part) > 1 for line in part)


@app.command("ack")
@graph_verb(timeout_s=5.0, changes=True)
def acknowledge(call: Call) -> None:
    """Acknowledge a trip whose cause is gone.

    Status 1: the cause is still there.
    """
    from palp_core.palpation.live_page.safety import acknowledge_text

    reply = call_safety(call.graph, "acknowledge", {}, call.timeout_s)
    call.show(reply, [acknowledge_text(reply)])
    if not reply["done"]:
        sys.exit(1)


@app.command("status")
@graph_verb(timeout_s=5.0)
def status(call: Call) -> None:
    """Show whether motion is permitted, and what was verified.

    Status 1: it is tripped.
    """
    reply = call_safety(call.graph, "status", {}, call.timeout_s)
    lines = [f"{reply['state']}" + (f": {reply['cause']}: {reply['text']}" if reply["cause"] else "")]
    if reply["warning"]:
        lines.append(f"warning: {reply['warning']}")
    call.show(reply, [*lines, checks_table(reply["checks"], reply["stamp_ns"])])
    if reply["cause"]:
        sys.exit(1)
