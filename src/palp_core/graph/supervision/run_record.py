"""Where everything of a running graph is, for those who look into its run directory and those who ask."""

from collections.abc import Mapping
from pathlib import Path

from palp_core.graph.description.checked import CheckedGraph, TopicInfo
from palp_core.graph.discovery.run_directory import NodeEntry, RunRecord, record_for
from palp_core.graph.node.loading import endpoints
from palp_core.graph.node.spec import COMPOSITION, LAUNCHER, NodeSpec
from palp_core.graph.supervision.launcher_node import LauncherNode


def run_record(
    checked: CheckedGraph,
    file: Path,
    folder: Path,
    pids: Mapping[str, int],
    *,
    composed: bool,
) -> RunRecord:
    """Return the record of a running graph.

    Args:
        checked: The graph.
        file: Its launch file, as given.
        folder: The run directory.
        pids: Process of every node that has one here.
        composed: All nodes are in this process.
    """

    def at(node: str) -> tuple[str, str]:
        return endpoints(str(folder), COMPOSITION if composed else node)

    nodes = [
        NodeEntry(spec.name, spec.run, pids.get(spec.name, 0), *at(spec.name)) for spec in checked.spawned
    ]
    topics = [info.as_topic(name, at(info.node)[0]) for name, info in checked.topics.items()]
    topics += LauncherNode.topics(str(folder))
    serve = endpoints(str(folder), LAUNCHER)[1]
    return record_for(checked.graph, str(file), checked.clock, serve, nodes, topics)


def run_record_of_node(spec: NodeSpec, outputs: Mapping[str, TopicInfo], folder: Path, pid: int) -> RunRecord:
    """Return the record of a node that this host runs alone, or as part of a graph elsewhere.

    Args:
        spec: The node.
        outputs: What it publishes, by topic.
        folder: The run directory.
        pid: Of its process; 0 before it has one.
    """
    ends = endpoints(str(folder), spec.name)
    topics = [info.as_topic(name, ends[0]) for name, info in outputs.items()]
    topics += LauncherNode.topics(str(folder))
    serve = endpoints(str(folder), LAUNCHER)[1]
    nodes = [NodeEntry(spec.name, spec.run, pid, *ends)]
    return record_for(spec.name, spec.run, "wall", serve, nodes, topics)
