"""Task ``delivery``: how messages come to a reader; declared for who asks, nothing that runs imports this.

A launch file states the clock and, per edge, the reliability; ``--compose`` puts all nodes into one process.
How many last messages are kept (``depth``) is a parameter of each. A declared function names the class that
does it.
"""

from typing import TYPE_CHECKING

from palp_core.graph.messages.qos import MOST_UNREAD
from palp_core.methods import Bound, declare_task, method

if TYPE_CHECKING:
    from palp_core.graph.lockstep.composition import Composition
    from palp_core.graph.lockstep.conductor import Conductor
    from palp_core.graph.transport.receiver import TopicReceiver
    from palp_core.graph.transport.reorder_buffer import ReorderBuffer

EVIDENCE = "tests/graph/launch/test_deliveries.py"
KEEPS_UP = {"reader_load": (0.0, 1.0)}
"""Messages a second times the seconds that the reader takes for each."""

_SIMULATED, _WALL = {"wall_clock": (0.0, 0.0)}, {"wall_clock": (1.0, 1.0)}
_FALLS_BEHIND = {"reader_load": (0.0, 2.0), "reader_s": (0.0, 0.002), "depth": (1.0, 10.0)}

declare_task(
    "delivery",
    "How do messages come to a reader?",
    per="a message of 50 samples, both ends",
    output="lost",
    tolerance=0.0,
)


@method(
    task="delivery",
    name="composed",
    cost_s=2.5e-5,
    bounds=[Bound("lost", 0.0), Bound("age_s", 0.0)],
    evidence=EVIDENCE,
    valid=_SIMULATED | {"process_count": (1.0, 1.0)},
    fails="a device, or a node that crashes or blocks: all nodes are one process, which waits for each",
    survivor="lockstep",
)
def composed() -> type["Composition"]:
    """All nodes in one process, one after the other."""
    from palp_core.graph.lockstep.composition import Composition

    return Composition


@method(
    task="delivery",
    name="lockstep",
    cost_s=9.2e-5,
    bounds=[Bound("lost", 0.0), Bound("age_s", 0.0)],
    evidence=EVIDENCE,
    valid=_SIMULATED,
    fails="a device: its time is the machine's, and waits for nobody",
    survivor="reliable",
)
def lockstep() -> type["Conductor"]:
    """Processes that the conductor hands the messages of each round."""
    from palp_core.graph.lockstep.conductor import Conductor

    return Conductor


@method(
    task="delivery",
    name="reliable",
    cost_s=0.00011,
    bounds=[
        Bound("lost", 0.0, within=KEEPS_UP | {"backlog": (0.0, MOST_UNREAD)}),
        Bound("age_s", 0.0016, within=KEEPS_UP),
    ],
    evidence=EVIDENCE,
    valid=_WALL,
    fails="a reader slower than its publisher hears things later and later; what it missed while it was dead "
    "is lost beyond the publisher's `depth`",
    survivor="best_effort",
)
def reliable() -> type["ReorderBuffer"]:
    """Sockets; what is missing is asked for again and comes in its order."""
    from palp_core.graph.transport.reorder_buffer import ReorderBuffer

    return ReorderBuffer


@method(
    task="delivery",
    name="best_effort",
    cost_s=0.00012,
    bounds=[
        Bound("lost", 1.0),
        Bound("age_s", 0.0016, within=KEEPS_UP),
        Bound("age_s", 0.033, within=_FALLS_BEHIND),
    ],
    evidence=EVIDENCE,
    valid=_WALL,
    fails="a gap is not filled, and a reader that falls behind skips to the last `depth` messages",
)
def best_effort() -> type["TopicReceiver"]:
    """Sockets; a reader that falls behind takes up the last messages only."""
    from palp_core.graph.transport.receiver import TopicReceiver

    return TopicReceiver
