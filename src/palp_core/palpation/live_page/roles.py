"""Which topic is which of the rig's, whatever a launch file calls its nodes: known by the message's type."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from palp_core.graph.messages.topic import Topic
from palp_core.view.source.overview import WireState
from palp_core.view.source.protocol import ViewSource

EXPERIMENT = "TrialResult"
"""What the experiment publishes, and nobody else."""
POLICY = "PolicyChange"
"""What the policy publishes, whichever class it is."""


def topics_by_type(topics: Sequence[Topic], wires: Sequence[WireState] = ()) -> dict[str, str]:
    """Return the topic of each message type.

    Of several of a type, as with a second estimator that only listens, the one that the experiment hears is
    meant; else one that anybody hears; else the first.
    """
    experiment = next((topic.node for topic in topics if topic.type == EXPERIMENT), "")
    by_experiment = {wire.topic for wire in wires if wire.reader == experiment}
    read_by_any = {wire.topic for wire in wires}
    found: dict[str, str] = {}
    for topic in sorted(topics, key=lambda one: (one.name not in by_experiment, one.name not in read_by_any)):
        found.setdefault(topic.type, topic.name)
    return found


def policy_at_work(source: ViewSource, topics: Mapping[str, str]) -> str:
    """Return the class that chooses now, ``module:Class``; "" over a bag, and where nobody can tell."""
    node, overview = _node_of(topics.get(POLICY, "")), source.overview()
    if overview.kind != "graph":  # a bag tells of the class with which its recording began
        return ""
    return next((one.run for one in overview.nodes if one.name == node), "")


def session_folder(source: ViewSource, topics: Mapping[str, str]) -> Path | None:
    """Return where a graph's record and report are written; None over a bag, and where nobody knows."""
    if source.overview().kind != "graph":
        return None
    launch = source.launch()
    out = launch.get("params", {}).get(_node_of(topics.get(EXPERIMENT, "")), {}).get("out")
    found = Path(launch.get("folder", ""), out) if isinstance(out, str) else Path()
    return found if found.is_absolute() else None


def _node_of(topic: str) -> str:
    return topic.partition("/")[2].partition("/")[0]
