"""A graph of nodes for anybody, and robotic palpation on top of it.

What a node file, a program that runs a graph and one that reads a recording need is here::

    from palp_core import Graph, Message, Node, Params, Pub, State, Sub, every, on, read, to_numpy

The names load on first use: :mod:`palp_core.palpation.mechanics` in a notebook loads nothing of the graph,
and a graph nothing of palpation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from palp_core.lazy_names import lazy_names

if TYPE_CHECKING:
    from palp_core.graph.bag.reader import Bag, read, to_numpy
    from palp_core.graph.launch.graph import Graph
    from palp_core.graph.launch.summary import RunSummary
    from palp_core.graph.messages.builtin import DiagnosticStatus, MethodsUsed, NodeEvent, Progress, Swap
    from palp_core.graph.messages.message import Message
    from palp_core.graph.messages.qos import Qos
    from palp_core.graph.node.action_client import WrappedResult
    from palp_core.graph.node.action_server import GoalHandle
    from palp_core.graph.node.bench import Bench
    from palp_core.graph.node.loading import enter_workspace
    from palp_core.graph.node.node import Node, Params, ReadOnly, State
    from palp_core.graph.node.ports import (
        Act,
        ActionClient,
        Alarm,
        Client,
        Pub,
        Srv,
        Sub,
        Timer,
        accept,
        every,
        execute,
        on,
        on_cancel,
        on_event,
        on_feedback,
        serve,
    )
    from palp_core.graph.node.qos_events import QosEvent

__version__ = "0.1.0"

__all__ = [
    "Act",
    "ActionClient",
    "Alarm",
    "Bag",
    "Bench",
    "Client",
    "DiagnosticStatus",
    "GoalHandle",
    "Graph",
    "Message",
    "MethodsUsed",
    "Node",
    "NodeEvent",
    "Params",
    "Progress",
    "Pub",
    "Qos",
    "QosEvent",
    "ReadOnly",
    "RunSummary",
    "Srv",
    "State",
    "Sub",
    "Swap",
    "Timer",
    "WrappedResult",
    "accept",
    "enter_workspace",
    "every",
    "execute",
    "on",
    "on_cancel",
    "on_event",
    "on_feedback",
    "read",
    "serve",
    "to_numpy",
]

__getattr__, __dir__ = lazy_names(__name__)
