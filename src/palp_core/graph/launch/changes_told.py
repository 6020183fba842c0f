"""What was changed of a run's nodes while it went on: classes that took a place, parameters that were set."""

import json
from bisect import insort
from collections.abc import Sequence
from typing import Any

import msgspec

from palp_core.graph.messages.builtin import GraphEvent, NodeEvent
from palp_core.graph.node.spec import LAUNCHER, topic

GRAPH_EVENTS = topic(LAUNCHER, "events")


class ChangeTold(msgspec.Struct, frozen=True):
    """A node was no longer what it had been.

    Attributes:
        node: Which.
        at_s: When, on the graph's clock.
        before: Its class until then; "" where only parameters were set.
        run: The class that took its place; "" likewise.
        params: Parameters that were set then, by name.
    """

    node: str
    at_s: float
    before: str = ""
    run: str = ""
    params: dict[str, Any] = {}


class ChangesTold:
    """Collects what launcher and nodes say of swaps and of parameters that were set.

    Attributes:
        told: In time's order.
    """

    def __init__(self) -> None:
        self.told: list[ChangeTold] = []

    def restore(self, told: Sequence[ChangeTold]) -> None:
        """Know what was said before an interruption."""
        self.told = list(told)

    def observe(self, _: int, name: str, event: GraphEvent | NodeEvent) -> None:
        """Take an event of the launcher or of a node."""
        self.note(name, event)

    def note(self, name: str, event: Any) -> None:
        """Note what an event on a topic tells, if it is a change."""
        if name == GRAPH_EVENTS and event.kind == "swapped":
            said = json.loads(event.data)
            given, classes = said.get("given", {}), (said["before"], said["after"])
            self._keep(ChangeTold(said["node"], said["at_s"], *classes, params=given))
        elif name != GRAPH_EVENTS and event.kind == "parameters":
            given = {name: after for name, (_, after) in json.loads(event.data).items()}
            self._keep(ChangeTold(name.split("/")[1], event.stamp_ns / 1e9, params=given))

    def _keep(self, change: ChangeTold) -> None:
        """Put a change in its place: a swap is told after its probation, when more may have been set."""
        insort(self.told, change, key=lambda one: one.at_s)


def last_set(changes: Sequence[ChangeTold], node: str) -> dict[str, Any]:
    """Return what was set of a node's parameters since its class was at work, by name."""
    found: dict[str, Any] = {}
    for change in changes:
        if change.node == node:
            found = {} if change.run != change.before else found
            found |= change.params
    return found
