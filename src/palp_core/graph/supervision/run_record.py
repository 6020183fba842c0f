"""Where everything of a running graph is, for those who look into its run directory and those who ask."""

from collections.abc import Mapping
from pathlib import Path

import msgspec

from palp_core.graph.description.checked import CheckedGraph, TopicInfo
from palp_core.graph.discovery.run_directory import NodeEntry, RunDirectory, RunRecord
from palp_core.graph.node.loading import endpoints
from palp_core.graph.node.spec import COMPOSITION, LAUNCHER, NodeSpec
from palp_core.graph.supervision.launcher_node import LauncherNode


def run_record(
    checked: CheckedGraph,
    file: Path,
    directory: RunDirectory,
    pids: Mapping[str, int],
    *,
    composed: bool,
) -> RunRecord:
    folder = str(directory.path)

    def at(node: str) -> tuple[str, str]:
        return endpoints(folder, COMPOSITION if composed else node)

    nodes = [
        NodeEntry(spec.name, spec.run, pids.get(spec.name, 0), *at(spec.name)) for spec in checked.spawned
    ]
    topics = [info.as_topic(name, at(info.node)[0]) for name, info in checked.topics.items()]
    topics += LauncherNode.topics(folder)
    serve = endpoints(folder, LAUNCHER)[1]
    found = directory.record(checked.graph, str(file), checked.clock, serve, nodes, topics)
    return msgspec.structs.replace(found, workspace=checked.workspace, view=checked.view)


def run_record_of_node(
    spec: NodeSpec, outputs: Mapping[str, TopicInfo], directory: RunDirectory, pid: int
) -> RunRecord:
    """Return the record of a node that this host runs alone, or as part of a graph elsewhere."""
    folder = str(directory.path)
    ends = endpoints(folder, spec.name)
    topics = [info.as_topic(name, ends[0]) for name, info in outputs.items()]
    topics += LauncherNode.topics(folder)
    serve = endpoints(folder, LAUNCHER)[1]
    nodes = [NodeEntry(spec.name, spec.run, pid, *ends)]
    return directory.record(spec.name, spec.run, "wall", serve, nodes, topics)
