"""Whether a wire fits: what a reader wants against what a publisher offers.

A launch file, a class that is to take a running node's place and a node that joins from another host are
judged here, in the same words.
"""

from typing import Literal, NamedTuple

from palp_core.graph.description.checked import CheckedGraph, TopicInfo
from palp_core.graph.messages.qos import incompatibility
from palp_core.graph.node.spec import topic

TRUTH = "truth"
"""Port of quantities that no instrument measures."""


class Misfit(NamedTuple):
    """Why a wire does not fit: which of its three parts, and a text that begins with the topic."""

    part: Literal["type", "qos", "truth"]
    text: str


class Disagreement(NamedTuple):
    """Two nodes that have different values of a parameter that both must know."""

    reader: str
    source: str
    parameter: str
    text: str


def disagreements(checked: CheckedGraph) -> list[Disagreement]:
    """Return on which shared parameters the nodes of a graph disagree."""
    params = {spec.name: spec.params for spec in checked.nodes}
    found = []
    for spec in (spec for spec in checked.nodes if spec.name in checked.classes):
        for port, names in checked.classes[spec.name].same_params.items():
            source = checked.topics[spec.inputs[port]].node if port in spec.inputs else ""
            read, published = spec.params, params.get(source, {})
            for name in names:
                if name in read and name in published and read[name] != published[name]:
                    text = f"{name} is {read[name]!r} in node '{spec.name}'"
                    text += f" and {published[name]!r} in node '{source}'; give both the same"
                    found.append(Disagreement(spec.name, source, name, text))
    return found


def misfit(wanted: TopicInfo, offered: TopicInfo, *, reads_truth: bool) -> Misfit | None:
    """Return the first of :func:`misfits`; None if the reader can read the topic."""
    return next(iter(misfits(wanted, offered, reads_truth=reads_truth)), None)


def misfits(wanted: TopicInfo, offered: TopicInfo, *, reads_truth: bool) -> list[Misfit]:
    """Return every reason why a reader cannot read a topic; another type alone is enough."""
    found = type_misfit(wanted, offered)
    if found is not None:
        return [found]
    name, reasons = topic(offered.node, offered.port), []
    if (reason := incompatibility(wanted.qos, offered.qos)) is not None:
        reasons.append(Misfit("qos", f"{name}: {reason}"))
    if offered.port == TRUTH and not reads_truth:
        reasons.append(Misfit("truth", f"{name}: only a node that simulates or records may read truth"))
    return reasons


def type_misfit(wanted: TopicInfo, offered: TopicInfo) -> Misfit | None:
    """Return how the type of a topic is another than the one that is wanted; None if it is the same."""
    if wanted.type_hash == offered.type_hash:
        return None
    name = topic(offered.node, offered.port)
    if wanted.type != offered.type:
        return Misfit("type", f"{name} carries {offered.type}, not {wanted.type}")
    return Misfit("type", f"{name} carries another {offered.type}, {_difference(wanted, offered)}")


def _difference(wanted: TopicInfo, offered: TopicInfo) -> str:
    """Return the first line in which two message texts of one name differ."""
    read, published = wanted.ros_text.splitlines(), offered.ros_text.splitlines()
    for line, published_line in zip(read, published, strict=False):
        if line != published_line:
            return f"with '{published_line}' where '{line}' is wanted"
    if len(read) > len(published):
        return f"without '{read[len(published)]}'"
    if len(read) < len(published):
        return f"with '{published[len(read)]}', too"
    return "which differs in a nested type"
