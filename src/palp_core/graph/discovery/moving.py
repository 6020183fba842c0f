"""Whether a running graph moves something: what others may do to it depends on that."""

from collections.abc import Collection, Iterable

from palp_core.errors import GraphError
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.node.spec import LAUNCHER

ASK_S = 5.0
SAFETY_TYPE, SAFETY_NAME = "SafetyBeat", "safety"


def moves_something_real(graph: RunningGraph) -> bool:
    """Tell whether a node moves something, and that not in simulated time; if nobody can say, one does."""
    if graph.record.clock == "sim":
        return False
    try:
        nodes = graph.ask(LAUNCHER, "launch", timeout_s=ASK_S)["nodes"]
    except GraphError:
        return True
    return any(spec.get("moves") for spec in nodes)


def safety_node(types: Iterable[tuple[str, str]], nodes: Collection[str]) -> str | None:
    """Return the node that stops motion, by the type that it publishes, whatever its name.

    Its name decides where several publish that, or none does: yours may have messages of its own. ``types``
    are pairs of node and type, of every topic.
    """
    beating = [node for node, kind in types if kind == SAFETY_TYPE]
    if SAFETY_NAME in nodes and (not beating or SAFETY_NAME in beating):
        return SAFETY_NAME
    return beating[0] if beating else None
