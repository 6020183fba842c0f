"""``palp safety`` and ``palp stop``: what the safety node says, stopping, and leaving a trip behind."""

import sys
from typing import Annotated, Any

import typer

from palp_core.cli.launch.stop_key import call_safety, stop_motion, stopped_words
from palp_core.cli.options import GraphOption, JsonOption, TimeoutOption, until_ctrl_c
from palp_core.cli.output import note, print_json, print_text
from palp_core.cli.running import find_graph
from palp_core.errors import GraphError

app = typer.Typer()


def stop(
    *,
    every: Annotated[
        bool, typer.Option("--all", help="Of every graph of this user, whatever its folder.")
    ] = False,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """It stays stopped until ``palp safety ack``."""
    from palp_core.graph.discovery.choice import WhichGraph

    if every and graph is not None:
        raise GraphError("--all stops every graph: leave out --graph, or leave out --all")
    with until_ctrl_c():
        if every:
            _stop_all(timeout, as_json=as_json)
            return
        try:
            running = find_graph(graph, changes=True)
            reply = stop_motion(running, "palp stop", timeout)
        except WhichGraph as error:
            raise GraphError(f"{error}\nor stop all of them: palp stop --all") from None
    if as_json:
        print_json(reply)
    else:
        print_text(stopped_words(reply, running.record.id))


def _stop_all(timeout_s: float, *, as_json: bool) -> None:
    """Stop all graphs at the same time, so that a silent one holds up none; status 2 if one was not."""
    from concurrent.futures import ThreadPoolExecutor

    from palp_core.graph.discovery.choice import START_ONE, line_of
    from palp_core.graph.discovery.run_directory import RunRecord, running
    from palp_core.graph.discovery.running_graph import RunningGraph

    def stopped(record: RunRecord) -> dict[str, Any] | GraphError:
        try:
            return stop_motion(RunningGraph(record), "palp stop --all", timeout_s)
        except GraphError as error:
            return error

    records = running()
    if not records:
        raise GraphError(f"no graph is running; {START_ONE}")
    with ThreadPoolExecutor(max_workers=len(records)) as pool:
        answers = list(zip(records, pool.map(stopped, records), strict=True))
    replies = {record.id: reply for record, reply in answers if isinstance(reply, dict)}
    if as_json:
        print_json(replies)
    for record, answer in answers:
        if isinstance(answer, GraphError):
            note(f"{line_of(record)}: {answer}")
        elif not as_json:
            again = f"when all is well: palp safety ack --graph {record.id}"
            print_text(f"{line_of(record)}: {answer['state']}: {answer['cause']}; {again}")
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
def acknowledge(
    *,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Acknowledge a trip whose cause is gone.

    Status 1: the cause is still there.
    """
    from palp_core.palpation.live_page.safety import acknowledged_words

    with until_ctrl_c():
        reply = call_safety(find_graph(graph, changes=True), "acknowledge", {}, timeout)
    if as_json:
        print_json(reply)
    else:
        print_text(acknowledged_words(reply))
    if not reply["done"]:
        sys.exit(1)


@app.command("status")
def status(
    *,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show whether motion is permitted, and what was verified.

    Status 1: it is tripped.
    """
    with until_ctrl_c():
        reply = call_safety(find_graph(graph), "status", {}, timeout)
    if as_json:
        print_json(reply)
    else:
        why = f": {reply['cause']}: {reply['text']}" if reply["cause"] else ""
        print_text(f"{reply['state']}{why}")
        if reply["warning"]:
            print_text(f"warning: {reply['warning']}")
        print_text(checks_table(reply["checks"], reply["stamp_ns"]))
    if reply["cause"]:
        sys.exit(1)
