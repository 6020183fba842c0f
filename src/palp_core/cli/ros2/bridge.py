"""``palp bridge ros2``."""

from __future__ import annotations

import signal
import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palp_core.cli.options import GraphOption, until_ctrl_c
from palp_core.cli.output import note, print_text
from palp_core.cli.running import find_graph, note_ended
from palp_core.counted import counted
from palp_core.errors import GraphError

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph
    from palp_core.graph.ros2.map_file import MapFile
    from palp_core.graph.ros2.plan import BridgePlan

TERMINATED = 143


def bridge(
    file: Annotated[
        str, typer.Argument(metavar="MAP.yaml", help="What crosses, and as what; see docs/ros2.md.")
    ],
    *,
    check: Annotated[bool, typer.Option("--check", help="Check the map, let nothing cross.")] = False,
    operate: Annotated[
        bool, typer.Option("--operate", help="ROS 2 may change a graph that moves something real.")
    ] = False,
    graph: GraphOption = None,
) -> None:
    """Let topics, services and parameters cross between a running graph and ROS 2, as a map says.

    It ends with the graph, or on Ctrl-C, and says what has crossed and what was lost; neither side depends
    on it. ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE hold as for any ROS 2 node. --check without a
    running graph checks the map by itself.
    """
    from palp_core.graph.problems import Problems
    from palp_core.graph.ros2.map_file import read_map
    from palp_core.graph.ros2.named_maps import find_map

    problems = Problems()
    described = read_map(find_map(file)[0], problems)
    with until_ctrl_c():
        if check:
            _check(described, graph, problems)
            return
        from palp_core.graph.discovery.moving import moves_something_real
        from palp_core.graph.ros2.bridge import graph_times
        from palp_core.graph.ros2.middleware import require
        from palp_core.graph.ros2.plan import make_plan

        require()
        running = find_graph(graph, changes=True)
        times = graph_times(running)
        plan = make_plan(described, running, times, problems)
        problems.raise_any()
        if plan.changes and not operate and moves_something_real(running):
            raise GraphError(
                "this graph moves something real, and by this map ROS 2 may change it (to_palp, services, "
                "calls, parameters): add --operate, or leave those out"
            )
        _run(running, described, plan, times)


def _check(described: MapFile, graph: str | None, problems: Any) -> None:
    from palp_core.graph.discovery.run_directory import running as all_running
    from palp_core.graph.ros2.bridge import graph_times
    from palp_core.graph.ros2.plan import check_alone, make_plan

    if graph is None and not all_running():
        check_alone(described, problems)
        problems.raise_any()
        print_text(f"{described.file}: no mistake by itself; no graph runs to check it against")
        return
    running = find_graph(graph, changes=True)
    make_plan(described, running, graph_times(running), problems)
    problems.raise_any()
    print_text(f"{described.file}: no mistake, beside graph '{running.record.graph}'")


def _run(running: RunningGraph, described: MapFile, plan: BridgePlan, times: Any) -> None:
    from palp_core.graph.ros2.bridge import Ros2Bridge
    from palp_core.graph.ros2.middleware import beyond_this_host

    if why := beyond_this_host():
        note(why)
    clock = running.record.clock == "sim" if described.clock is None else described.clock
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))
    made = Ros2Bridge(running, plan, times, name=described.node, clock=clock, say=note)
    signal.signal(signal.SIGINT, made.interrupt)
    try:
        with made:
            print_text(f"graph '{running.record.graph}' beside ROS 2, as /{described.node} ({_ways(plan)})")
            sys.stdout.flush()
            made.run()
    finally:
        for account in made.accounts:
            print_text(str(account))
        sys.stdout.flush()
    if made.ended:
        note_ended(running)


def _ways(plan: BridgePlan) -> str:
    counts = (
        (plan.to_ros2, "topic to ROS 2", "topics to ROS 2"),
        (plan.to_palp, "topic from ROS 2", "topics from ROS 2"),
        (plan.services, "service", "services"),
        (plan.calls, "call", "calls"),
        (plan.parameters, "node's parameters", "nodes' parameters"),
    )
    ways = [counted(len(ways), one, several) for ways, one, several in counts if ways]
    if plan.awaited is not None and (names := plan.awaited.names):
        ways.append(f"what is said of nodes that have yet to join: {', '.join(names)}")
    return ", ".join(ways)
