"""Whether a running graph moves something: what others may do to it depends on that."""

from palp_core.errors import GraphError
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.node.spec import LAUNCHER

ASK_S = 5.0


def moves_something_real(graph: RunningGraph) -> bool:
    """Tell whether a node moves something, and that not in simulated time; if nobody can say, one does."""
    if graph.record.clock == "sim":
        return False
    try:
        nodes = graph.ask(LAUNCHER, "launch", timeout_s=ASK_S)["nodes"]
    except GraphError:
        return True
    return any(spec.get("moves") for spec in nodes)
