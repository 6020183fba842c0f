"""``palp bridge``: ways from a running graph into other programs."""

from __future__ import annotations

import signal
import sys
from typing import TYPE_CHECKING, Annotated

from palp_core.cli.lazy import Verb, lazy_app
from palp_core.cli.options import TERMINATED, GraphOption, argument, option, until_ctrl_c
from palp_core.cli.output import note, print_text
from palp_core.cli.running import find_graph, note_ended
from palp_core.counted import counted
from palp_core.errors import GraphError
from palp_core.extras import install_line

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph
    from palp_core.graph.ros2.maps import Entry
    from palp_core.graph.ros2.plan import Crossing


app = lazy_app(
    {
        "foxglove": Verb(
            "palp_core.cli.bridge:foxglove", "Show topics, log, parameters and services in Foxglove."
        ),
        "ros2": Verb("palp_core.cli.bridge:ros2", "Exchange topics, services and parameters with ROS 2."),
    }
)


def foxglove(
    *,
    port: Annotated[
        int, option("Where it listens; 0: any free port.", "--port", "-p", min=0, max=65535)
    ] = 8765,
    host: Annotated[str, option("An address of this host.", metavar="ADDRESS")] = "127.0.0.1",
    read_only: Annotated[bool, option("Viewers change nothing.", "--read-only")] = False,
    operate: Annotated[
        bool, option("Viewers may change a graph that moves something real.", "--operate")
    ] = False,
    rate: Annotated[
        float, option("Most messages per second of a topic; 0: all.", "--rate", "-r", min=0.0)
    ] = 60.0,
    origin: Annotated[
        list[str] | None,
        option("Let a page of another host connect, too; repeatable.", metavar="URL"),
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


def ros2(
    map_: Annotated[str, argument("Module (nodes.ros2_map) or file: docs/how_to/ros2.md.", "MAP")],
    *,
    check: Annotated[bool, option("Check the map, let nothing cross.", "--check")] = False,
    operate: Annotated[
        bool, option("ROS 2 may change a graph that moves something real.", "--operate")
    ] = False,
    graph: GraphOption = None,
) -> None:
    """A map has functions from a message of one side to a message of the other.

    The bridge ends with the graph, or on Ctrl-C, and prints what has crossed and what was lost. ROS_DOMAIN_ID
    and ROS_AUTOMATIC_DISCOVERY_RANGE hold as for any ROS 2 node. --check without a running graph checks the
    map by itself.
    """
    from palp_core.graph.discovery.run_directory import running as all_running
    from palp_core.graph.ros2.maps import read_map

    entries = read_map(map_)
    with until_ctrl_c():
        if check and graph is None and not all_running():
            print_text(f"{map_}: no mistake by itself; no graph runs to check it against")
            return
        from palp_core.graph.problems import Problems
        from palp_core.graph.ros2.middleware import require
        from palp_core.graph.ros2.plan import plan_crossings

        running = find_graph(graph, changes=True)
        problems = Problems()
        crossings = plan_crossings(entries, running, problems)
        problems.raise_any()
        if check:
            print_text(f"{map_}: no mistake, checked against graph '{running.record.graph}'")
            return
        if _changes(entries) and not operate and running.moves_something_real():
            raise GraphError(
                "this graph moves something real, and by this map ROS 2 may change it (from_ros2, "
                "serve_ros2, call_ros2 with to, share_parameters): add --operate, or leave those out"
            )
        require()
        _run(running, crossings)


def _changes(entries: list[Entry]) -> bool:
    """Whether ROS 2 may change something in the graph."""
    return any(entry.to or entry.kind not in ("to_ros2", "call") for entry in entries)


def _run(running: RunningGraph, crossings: list[Crossing]) -> None:
    from palp_core.graph.ros2.bridge import Ros2Bridge
    from palp_core.graph.ros2.middleware import beyond_this_host

    if why := beyond_this_host():
        note(why)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))
    made = Ros2Bridge(running, crossings, note)
    signal.signal(signal.SIGINT, made.interrupt)
    try:
        with made:
            ways = _ways(crossings)
            print_text(f"graph '{running.record.graph}': bridge to ROS 2 as /{made.name} ({ways})")
            sys.stdout.flush()
            made.run()
    finally:
        for account in made.accounts:
            print_text(str(account))
        sys.stdout.flush()
    if made.ended:
        note_ended(running)


def _ways(crossings: list[Crossing]) -> str:
    words = {
        "to_ros2": ("topic to ROS 2", "topics to ROS 2"),
        "from_ros2": ("topic from ROS 2", "topics from ROS 2"),
        "service": ("service", "services"),
        "call": ("call", "calls"),
        "parameters": ("node's parameters", "nodes' parameters"),
    }
    kinds = [crossing.entry.kind for crossing in crossings]
    return ", ".join(counted(kinds.count(kind), *names) for kind, names in words.items() if kind in kinds)
