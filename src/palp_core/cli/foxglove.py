"""``palp bridge foxglove``."""

from typing import Annotated

import typer

from palp_core.cli.options import GraphOption, until_ctrl_c
from palp_core.cli.output import note, print_text
from palp_core.cli.running import find_graph, note_ended
from palp_core.errors import GraphError
from palp_core.extras import install_line


def foxglove(
    *,
    port: Annotated[
        int, typer.Option("--port", "-p", min=0, max=65535, help="Where it listens; 0: any free port.")
    ] = 8765,
    host: Annotated[
        str, typer.Option("--host", metavar="ADDRESS", help="An address of this host.")
    ] = "127.0.0.1",
    read_only: Annotated[bool, typer.Option("--read-only", help="Viewers change nothing.")] = False,
    operate: Annotated[
        bool,
        typer.Option("--operate", help="Viewers may change a graph that moves something real."),
    ] = False,
    rate: Annotated[
        float, typer.Option("--rate", "-r", min=0.0, help="Most messages per second of a topic; 0: all.")
    ] = 60.0,
    origin: Annotated[
        list[str] | None,
        typer.Option("--origin", metavar="URL", help="Let a page of another host connect, too; repeatable."),
    ] = None,
    graph: GraphOption = None,
) -> None:
    """It prints the address that Foxglove asks for under "Open connection"; only who has it gets in. Viewers
    may set parameters and call services; where a node moves something on the wall clock, only with --operate.
    """
    if read_only and operate:
        raise GraphError("give either --read-only or --operate")
    try:
        from palp_core.graph.foxglove.server import FoxgloveServer
        from palp_core.graph.network.address import resolve
    except ImportError as error:
        raise GraphError(f"foxglove-sdk cannot be used: {error}; {install_line('foxglove')}") from error
    with until_ctrl_c():
        number = resolve(host, f"--host {host}")
        if number.is_unspecified:
            raise GraphError(f"--host {host}: write the address by which viewers call this host")
        if not number.is_loopback:
            note(f"other hosts can reach {host}, and nothing is encrypted: ssh -L to 127.0.0.1 is safer")
        running = find_graph(graph, changes=operate)
        with FoxgloveServer(
            running, host=host, port=port, fastest_hz=rate, read_only=read_only, operate=operate,
            origins=origin or (),
        ) as server:  # fmt: skip
            may = "viewers read only" if server.refusal else "viewers may set parameters and call services"
            print_text(f"graph '{running.record.graph}' in Foxglove at {server.address} ({may})")
            while not server.ended:
                server.turn()
        note_ended(running)
