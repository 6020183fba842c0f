"""``palp safety`` and ``palp stop``: what the safety node says, stopping, and leaving a trip behind."""

import sys

import typer

from palp_core.cli.launch.stop_key import call_safety, stop_motion
from palp_core.cli.options import GraphOption, JsonOption, TimeoutOption, until_ctrl_c
from palp_core.cli.output import print_json, print_text
from palp_core.cli.running import find_graph

app = typer.Typer(help="The safety node of the running graph.", no_args_is_help=True, rich_markup_mode=None)


def stop(
    *,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Stop all motion now: ABORT, then DISABLE; it stays so until ``palp safety ack``."""
    with until_ctrl_c():
        reply = stop_motion(find_graph(graph), "palp stop", timeout)
    if as_json:
        print_json(reply)
    else:
        print_text(f"{reply['state']}: {reply['cause']}; when all is well: palp safety ack")


@app.command("ack")
def acknowledge(
    *,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Leave a trip behind, once its cause is gone; the exit status is 1 if it is not."""
    with until_ctrl_c():
        reply = call_safety(find_graph(graph), "acknowledge", {}, timeout)
    if as_json:
        print_json(reply)
    else:
        print_text(
            reply["state"] if reply["done"] else f"{reply['state']}: not acknowledged: {reply['text']}"
        )
    if not reply["done"]:
        sys.exit(1)


@app.command("status")
def status(
    *,
    timeout: TimeoutOption = 5.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Say whether motion is permitted and, if not, why; the exit status is 1 while it is tripped."""
    with until_ctrl_c():
        reply = call_safety(find_graph(graph), "status", {}, timeout)
    if as_json:
        print_json(reply)
    else:
        why = f": {reply['cause']}: {reply['text']}" if reply["cause"] else ""
        print_text(f"{reply['state']}{why}")
        if reply["warning"]:
            print_text(f"warning: {reply['warning']}")
        if reply.get("dead_man"):
            print_text(f"dead-man: {reply['dead_man']}")
    if reply["cause"]:
        sys.exit(1)
