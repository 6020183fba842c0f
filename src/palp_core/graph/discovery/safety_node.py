"""Which node of a running graph stops motion."""

from collections.abc import Collection, Iterable

SAFETY_TYPE, SAFETY_NAME = "SafetyBeat", "safety"


def safety_node(types: Iterable[tuple[str, str]], nodes: Collection[str]) -> str | None:
    """Return the node that stops motion, by the type that it publishes, whatever its name.

    Its name decides where several publish that, or none does: yours may have messages of its own. ``types``
    are pairs of node and type, of every topic.
    """
    beating = [node for node, kind in types if kind == SAFETY_TYPE]
    if SAFETY_NAME in nodes and (not beating or SAFETY_NAME in beating):
        return SAFETY_NAME
    return beating[0] if beating else None
