"""``palp bridge ros2``."""

from __future__ import annotations

import signal
import sys
from typing import TYPE_CHECKING, Annotated

import typer

from palp_core.cli.options import GraphOption, until_ctrl_c
from palp_core.cli.output import note, print_text
from palp_core.cli.running import find_graph, note_ended
from palp_core.counted import counted
from palp_core.errors import GraphError

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph
    from palp_core.graph.ros2.maps import Entry
    from palp_core.graph.ros2.plan import Crossing, Joining

TERMINATED = 143


def bridge(
    map_: Annotated[
        str,
        typer.Argument(metavar="MAP", help="A module (nodes.ros2_map) or a file (map.py); see docs/ros2.md."),
    ],
    *,
    check: Annotated[bool, typer.Option("--check", help="Check the map, let nothing cross.")] = False,
    operate: Annotated[
        bool, typer.Option("--operate", help="ROS 2 may change a graph that moves something real.")
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
        from palp_core.graph.discovery.moving import moves_something_real
        from palp_core.graph.problems import Problems
        from palp_core.graph.ros2.middleware import require
        from palp_core.graph.ros2.plan import Joining

        running = find_graph(graph, changes=True)
        joining, problems = Joining(running, entries), Problems()
        crossings = joining.plan(problems)
        problems.raise_any()
        if check:
            print_text(f"{map_}: no mistake, checked against graph '{running.record.graph}'")
            return
        if _changes(entries) and not operate and moves_something_real(running):
            raise GraphError(
                "this graph moves something real, and by this map ROS 2 may change it (from_ros2, "
                "serve_ros2, call_ros2 with to, share_parameters): add --operate, or leave those out"
            )
        require()
        _run(running, crossings, joining)


def _changes(entries: list[Entry]) -> bool:
    """Whether ROS 2 may change something in the graph."""
    return any(entry.to or entry.kind not in ("to_ros2", "call") for entry in entries)


def _run(running: RunningGraph, crossings: list[Crossing], joining: Joining) -> None:
    from palp_core.graph.ros2.bridge import Ros2Bridge
    from palp_core.graph.ros2.middleware import beyond_this_host

    if why := beyond_this_host():
        note(why)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))
    made = Ros2Bridge(running, crossings, joining, note)
    signal.signal(signal.SIGINT, made.interrupt)
    try:
        with made:
            ways = _ways(crossings, joining)
            print_text(f"graph '{running.record.graph}': bridge to ROS 2 as /{made.name} ({ways})")
            sys.stdout.flush()
            made.run()
    finally:
        for account in made.accounts:
            print_text(str(account))
        sys.stdout.flush()
    if made.ended:
        note_ended(running)


def _ways(crossings: list[Crossing], joining: Joining) -> str:
    words = {
        "to_ros2": ("topic to ROS 2", "topics to ROS 2"),
        "from_ros2": ("topic from ROS 2", "topics from ROS 2"),
        "service": ("service", "services"),
        "call": ("call", "calls"),
        "parameters": ("node's parameters", "nodes' parameters"),
    }
    kinds = [crossing.entry.kind for crossing in crossings]
    ways = [counted(kinds.count(kind), *names) for kind, names in words.items() if kind in kinds]
    if names := [entry.palp for entry in joining.awaited if entry.palp]:
        ways.append(f"for nodes that have yet to join: {', '.join(names)}")
    return ", ".join(ways)
