"""What viewers ask for, from the SDK's threads: queued for the server's own, or answered by the graph."""

from __future__ import annotations

import json
from collections.abc import Mapping
from queue import SimpleQueue
from typing import Any, NamedTuple

from foxglove import Parameter
from foxglove.websocket import ChannelView, Client, ServerListener

from palp_core.errors import GraphError
from palp_core.graph.foxglove.graph_access import GraphAccess


class SubscriptionChange(NamedTuple):
    """A viewer has begun, or ceased, to look at a topic."""

    viewer: int
    topic: str
    begins: bool


class Viewers(ServerListener):
    """Takes what viewers want."""

    def __init__(self, access: GraphAccess) -> None:
        self._access = access
        # In order, who has begun or ceased to look at what, and why parameters were not set.
        self.wanted: SimpleQueue[SubscriptionChange | str] = SimpleQueue()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self.wanted.put(SubscriptionChange(client.id, channel.topic, begins=True))

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        self.wanted.put(SubscriptionChange(client.id, channel.topic, begins=False))

    def on_get_parameters(
        self, client: Client, param_names: list[str], request_id: str | None = None
    ) -> list[Parameter]:
        return as_parameters(self._access.parameters(param_names))

    def on_set_parameters(
        self, client: Client, parameters: list[Parameter], request_id: str | None = None
    ) -> list[Parameter]:
        """Set them, and answer with what they are then; why one is refused comes as a status."""
        wanted = {parameter.name: parameter.get_value() for parameter in parameters}
        try:
            self._access.set_parameters(wanted)
        except GraphError as error:
            self.wanted.put(str(error))
        return as_parameters(self._access.parameters(wanted))


def as_parameters(values: Mapping[str, Any]) -> list[Parameter]:
    """Return parameters as the SDK has them; what it has no way to say stands as JSON text."""
    found = []
    for name, value in values.items():
        try:
            found.append(Parameter(name, value=value))
        except TypeError:  # a null within a mapping, say
            found.append(Parameter(name, value=json.dumps(value)))
    return found
