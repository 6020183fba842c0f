"""Who may join a running graph: the launch file's rules, applied to a node that comes later."""

from collections.abc import Collection

from palp_core.graph.description.checked import TopicInfo
from palp_core.graph.description.wire_check import misfit, type_misfit
from palp_core.graph.network.join_protocol import GraphView, JoinRequest
from palp_core.graph.node.spec import name_mistake, topic
from palp_core.graph.problems import hint

_MOST_PORTS = 256
_OLDER = "; update the older host"


def objections(request: JoinRequest, view: GraphView, taken: Collection[str]) -> list[str]:
    """Return every reason why a node cannot join; none if it can.

    Args:
        request: Who wants to join.
        view: The graph.
        taken: Names of the nodes that run.
    """
    name = request.name
    found = []
    if mistake := name_mistake(name):
        return [mistake]
    if len(request.inputs) + len(request.outputs) > _MOST_PORTS:
        return [f"a node of more than {_MOST_PORTS} ports cannot join"]
    if name in taken:
        found.append(f"a node '{name}' is in graph '{view.graph}' already; choose another with --name")
    strange = [output for output in request.outputs if not output.startswith(f"/{name}/")]
    if strange:
        found.append(f"a node publishes under its own name only, not {', '.join(strange)}")
    found += _expected(request, view)
    for port, wanted in request.inputs.items():
        found += [
            f"input '{port}': {reason}" for reason in _input(wanted, view, reads_truth=request.reads_truth)
        ]
    for source, target in request.feeds.items():
        found += _feed(source, target, request, view)
    return found


def _expected(request: JoinRequest, view: GraphView) -> list[str]:
    """A node that others are wired to must publish what they were checked against."""
    if request.name not in view.expected:
        return []
    found = []
    for name, promised in view.topics.items():
        if promised.node != request.name:
            continue
        offered = request.outputs.get(name)
        if offered is None:
            found.append(f"{request.run} lacks output '{promised.port}', which the launch file relies on")
        elif (other := type_misfit(promised, offered)) is not None:
            found.append(other.text + _OLDER)
    return found


def _input(wanted: TopicInfo, view: GraphView, *, reads_truth: bool) -> list[str]:
    name = topic(wanted.node, wanted.port)
    offered = view.topics.get(name)
    if offered is None:
        return [f"no topic '{name}' in graph '{view.graph}'{hint(name, view.topics)}"]
    found = misfit(wanted, offered, reads_truth=reads_truth)
    if found is None:
        return []
    same_name = found.part == "type" and wanted.type == offered.type
    return [found.text + (_OLDER if same_name else "")]


def _feed(source: str, target: str, request: JoinRequest, view: GraphView) -> list[str]:
    offered = request.outputs.get(source)
    if offered is None:
        return [f"{request.run} publishes no {source}"]
    if target not in view.external:
        known = f"; it has: {', '.join(view.external)}" if view.external else "; it declares none"
        return [f"{target} is no port that graph '{view.graph}' declares external{known}"]
    wanted = view.external[target]
    if wanted not in ("", offered.type_hash):
        return [f"{target} takes another type than {offered.type}, which {source} carries"]
    return []
