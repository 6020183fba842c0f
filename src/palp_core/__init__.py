"""Robotic palpation: a node graph, the mechanics of a soft probe, and the perception of depth.

The names a node file needs are here: ``from palp_core import Node, Params, Pub, State, Sub, every, on``.
They load on first use, so that importing :mod:`palp_core.mechanics` in a notebook loads nothing of the graph.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palp_core.runtime.bench import Bench
    from palp_core.runtime.builtin import NodeEvent, Progress, Swap
    from palp_core.runtime.events import QosEvent
    from palp_core.runtime.message import Message
    from palp_core.runtime.node import Node, Params, ReadOnly, State
    from palp_core.runtime.ports import Alarm, Client, Pub, Srv, Sub, Timer, every, on, on_event, serve
    from palp_core.runtime.qos import Qos

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
    "Bench": "bench",
    "Progress": "builtin",
    "Swap": "builtin",
    "Message": "message",
    "Node": "node",
    "NodeEvent": "builtin",
    "Params": "node",
    "ReadOnly": "node",
    "State": "node",
    "Qos": "qos",
    "QosEvent": "events",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'palp_core' has no attribute '{name}'")
    return getattr(importlib.import_module(f"palp_core.runtime.{_HOME.get(name, 'ports')}"), name)
