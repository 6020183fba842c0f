"""``palp run``: one node alone, or added to a graph that runs elsewhere."""

import sys
from typing import Annotated

from palp_core.cli.options import argument, option
from palp_core.cli.output import note
from palp_core.errors import GraphError, NodeError


def run(
    target: Annotated[str, argument("As in nodes.torque:Torque, or path.py:Class.", "MODULE:CLASS")],
    *,
    name: Annotated[
        str | None, option("Running name; default: from the class.", "--name", "-n", metavar="NAME")
    ] = None,
    params: Annotated[
        list[str] | None, option("A parameter; repeat for more.", "--param", "-p", metavar="NAME:=VALUE")
    ] = None,
    remap: Annotated[
        list[str] | None,
        option("Wire an input to a topic.", "--remap", "-r", metavar="PORT:=TOPIC"),
    ] = None,
    join: Annotated[
        str | None, option("Join the graph launched with --listen there.", metavar="tcp://HOST:PORT")
    ] = None,
    server_key: Annotated[
        str | None, option("That host's public key, its file, or its name here.", metavar="KEY")
    ] = None,
) -> None:
    """The exit status is the node's; 1 if it failed or its graph was lost, 2 if it could not run or join."""
    from palp_core.cli.values import assignments, value_of
    from palp_core.graph.network.address import plan_call
    from palp_core.graph.network.keys import KeyFolder
    from palp_core.graph.network.run_node import run_node
    from palp_core.graph.supervision.interrupt import Interrupted

    if server_key is not None and join is None:
        raise GraphError("--server-key belongs to --join tcp://HOST:PORT")
    try:
        code = run_node(
            target,
            name=name,
            params={port: value_of(text) for port, text in assignments("-p", params).items()},
            wires=assignments("-r", remap),
            address=plan_call(join, server_key, KeyFolder()) if join is not None else None,
            note=note,
        )
    except Interrupted as stop:
        note(f"{stop}; the node exited")
        code = 128 + int(stop.signal)
    except NodeError as error:
        note(str(error))
        code = 1
    sys.exit(code if 0 <= code < 256 else 1)
