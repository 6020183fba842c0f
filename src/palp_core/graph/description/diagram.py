"""Draw a checked graph as Mermaid text."""

from collections.abc import Iterator
from typing import NamedTuple

from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.node.spec import action_of

_TRUTH = "truth"


class Wire(NamedTuple):
    """From an output to the node that reads it; one that carries the truth is drawn dashed."""

    source: str
    port: str
    target: str
    truth: bool = False


def wires_of(graph: CheckedGraph) -> Iterator[Wire]:
    """Yield one wire per input; that of a client runs from the client to the service or action."""
    drawn = set()
    for spec in graph.nodes:
        for port, source in spec.inputs.items():
            if action := action_of(port):
                if (spec.name, action) not in drawn:
                    drawn.add((spec.name, action))
                    yield Wire(spec.name, action, source.split("/")[1])
                continue
            node, _, output = source.removeprefix("/").partition("/")
            if [node, output] in graph.edges.get(f"/{spec.name}/{port}", []):
                yield Wire(spec.name, port, node)
            else:
                yield Wire(node, output, spec.name, truth=output == _TRUTH)


def mermaid(graph: CheckedGraph) -> str:
    lines = ["flowchart LR"]
    lines += [f'    {s.name}("<b>{s.name}</b><br/>{s.run.rpartition(":")[2]}")' for s in graph.nodes]
    for wire in wires_of(graph):
        arrow = "-.->" if wire.truth else "-->"
        lines.append(f'    {wire.source} {arrow}|"{wire.port}"| {wire.target}')
    return "\n".join(lines) + "\n"
