"""Robotic palpation: a node graph, the mechanics of a soft probe, and the perception of depth.

The names a node file needs are here: ``from palp_core import Node, Params, Pub, State, Sub, every, on``.
They load on first use, so that importing :mod:`palp_core.palpation.mechanics` in a notebook loads nothing
of the graph.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palp_core.graph.messages.builtin import NodeEvent, Progress, Swap
    from palp_core.graph.messages.message import Message
    from palp_core.graph.messages.qos import Qos
    from palp_core.graph.node.bench import Bench
    from palp_core.graph.node.node import Node, Params, ReadOnly, State
    from palp_core.graph.node.ports import Alarm, Client, Pub, Srv, Sub, Timer, every, on, on_event, serve
    from palp_core.graph.node.qos_events import QosEvent

__version__ = "0.1.0"

__all__ = [
    "Alarm",
    "Bench",
    "Client",
    "Message",
    "Node",
    "NodeEvent",
    "Params",
    "Progress",
    "Pub",
    "Qos",
    "QosEvent",
    "ReadOnly",
    "Srv",
    "State",
    "Sub",
    "Swap",
    "Timer",
    "every",
    "on",
    "on_event",
    "serve",
]

_HOME = {
    "Bench": "node.bench",
    "Progress": "messages.builtin",
    "Swap": "messages.builtin",
    "Message": "messages.message",
    "Node": "node.node",
    "NodeEvent": "messages.builtin",
    "Params": "node.node",
    "ReadOnly": "node.node",
    "State": "node.node",
    "Qos": "messages.qos",
    "QosEvent": "node.qos_events",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'palp_core' has no attribute '{name}'")
    return getattr(importlib.import_module(f"palp_core.graph.{_HOME.get(name, 'node.ports')}"), name)
