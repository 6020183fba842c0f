"""Draw a checked graph: as Mermaid text for documents, as DOT text for Graphviz."""

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


def dot(graph: CheckedGraph) -> str:
    """Return a directed graph in Graphviz's language.

    Every name is quoted; names and classes are identifiers, so that nothing in them needs an escape.
    """
    lines = [f'digraph "{graph.graph}" {{', "    rankdir=LR;", '    node [shape=box, style="rounded"];']
    lines += [f'    "{s.name}" [label="{s.name}\\n{s.run.rpartition(":")[2]}"];' for s in graph.nodes]
    for wire in wires_of(graph):
        style = ", style=dashed" if wire.truth else ""
        lines.append(f'    "{wire.source}" -> "{wire.target}" [label="{wire.port}"{style}];')
    return "\n".join([*lines, "}"]) + "\n"
