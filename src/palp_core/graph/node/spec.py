"""What one node of a checked graph needs to know to run."""

import re
from typing import Any

import msgspec

from palp_core.graph.messages.qos import Qos

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}")
"""What a graph, a node and a port may be called."""

RECORDER = "palp_core.graph.recording.recorder_node:Recorder"
"""What a node runs that records its graph."""

LONGEST_BACKOFF_S = 3600
"""What a node waits at most before it is started again, however often that was in vain."""

HUNG_S = {"wall": 5.0, "sim": 60.0}
"""A handler on probation that takes longer does not return, by the graph's clock; of the machine's time.

Assumed: on the wall clock a swap is for nodes that answer; what comes of simulated time must not depend on
how busy the machine is, and no handler takes so long.
"""

LAUNCHER, GATEWAY, COMPOSITION, MERGED_LOG = "graph", "gateway", "composition", "merged"
RESERVED_NAMES = {
    LAUNCHER: "/graph/events and /graph/health are its topics",
    GATEWAY: "the process that other hosts call answers under it",
    COMPOSITION: "the one process of a composed graph has it",
    MERGED_LOG: "merged.log has the lines of all nodes",
}
"""What no node may be called, and why."""

GRAPH_EVENTS, GRAPH_HEALTH = f"/{LAUNCHER}/events", f"/{LAUNCHER}/health"
"""The launcher's own topics."""


def name_mistake(name: str) -> str:
    """Return why nothing can be a node of that name, and what to do; "" if a node can."""
    if NAME.fullmatch(name) is None:
        return f"'{name}' cannot be a node's name; use letters, digits and _, at most 32"
    if name in RESERVED_NAMES:
        why = f"it is the launcher's own: {RESERVED_NAMES[name]}"
        return f"'{name}' cannot be a node's name; {why}; choose another"
    return ""


def topic(node: str, port: str) -> str:
    """Return the name of the topic that a port publishes."""
    return f"/{node}/{port}"


_PART = "/_action/"
"""What the name of every part of an action has in it; as in ROS 2 such names are not listed."""


def part(name: str, of: str) -> str:
    """Return the name of a part of an action: ``move/_action/status``."""
    return f"{of}{_PART}{name}"


def action_of(port: str) -> str:
    """Return the action that a port, or a topic, is a part of; "" if it is none.

    >>> action_of("move/_action/status"), action_of("pose")
    ('move', '')
    """
    action, is_part, _ = port.partition(_PART)
    return action if is_part else ""


class NodeSpec(msgspec.Struct, frozen=True, kw_only=True):
    """One node of a checked graph."""

    name: str  # running name
    run: str  # ``module:Class``
    # every parameter as a plain value, defaults included, already validated against the class
    params: dict[str, Any] = {}
    inputs: dict[str, str] = {}  # topic per input port; for a client, the service's topic
    requests: dict[str, list[str]] = {}  # topics of the clients of each service port
    seed: int = 0  # of the graph; with the name it determines the node's random numbers
    epoch: int = 0  # how often the node has been restarted
    restart: str = "never"
    max_restarts: int = 3
    backoff_s: float = 0.2
    shutdown_on_exit: bool = False
    moves: bool = False
    # per input port what holds on its edge: the request, with the offered lifespan where it is shorter
    qos: dict[str, Qos] = {}
    # input ports that take messages from outside the graph, on the topic ``/<name>/<port>``
    external: list[str] = []
    realtime_priority: int = 0  # SCHED_FIFO priority; 0: the ordinary scheduler
    # ``screen``: all that it prints is shown where the graph was launched; ``log``: only warnings and errors
    # are
    output: str = "log"
    joined: bool = False  # its process is on another host, from where it joins with ``palp run --join``
    # topics that its class does not publish and optional inputs of others read, with type hash and quality of
    # service: their sequence goes on when a class comes that does
    vacant: dict[str, tuple[str, Qos]] = {}
    # wall clock: the topic with each message of which the node is written down; "": it never is
    keeps_at: str = ""
