"""All that an executor hands over so that another continues as if nothing had happened.

The same bytes serve a hot swap (one node, now), a checkpoint (all nodes at one instant) and a replay that
starts in the middle.
"""

from typing import Any

import msgspec

from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.messages.message import decode_any, encode_any
from palp_core.graph.node.action_client import SentGoals
from palp_core.graph.node.action_server import ServedGoals
from palp_core.graph.node.node import State
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.node.service_client import Pending

VERSION = 2


class HandOver(msgspec.Struct, frozen=True, kw_only=True):
    """A node at a handler boundary."""

    version: int = VERSION
    node_class: str
    state_class: str = ""  # which type the state is of; "": not known
    state_version: int
    state: bytes
    params: dict[str, Any]  # parameters as they are now, live changes included
    epoch: int
    now_ns: int
    inbox: list[bytes]  # frames received and not yet consumed, as they came
    consumed: dict[str, SequenceAccount]  # account of every input topic
    published: dict[str, int]  # last sequence of every output topic
    history: dict[str, list[bytes]]  # last frames of every output topic, as many as its depth
    # next tick number per periodic timer, and when it is due in ns (None: stopped)
    timers: dict[str, tuple[int, int | None]]
    alarms: dict[str, int]  # due time per set alarm, in ns
    rng: str  # state of the random generator
    events: dict[str, int] = {}  # how often each quality-of-service event has happened
    calls: dict[str, list[Pending]] = {}  # unanswered calls per client
    served: dict[str, ServedGoals] = {}  # goals of each action
    sent: dict[str, SentGoals] = {}  # goals of each client of an action that have not ended
    idle: list[str] = []  # output topics on which nothing is due until the next message
    active: bool = True  # one that was deactivated stays so
    finished: bool = False  # whether its work is done
    swaps: list[dict[str, Any]] = []  # every time it has changed hands, the latest last
    # the last message that each input has handled, with its topic, the oldest first; only where a successor
    # is to be tried on them
    latest: list[tuple[str, bytes]] = []


class Predecessor(msgspec.Struct, frozen=True):
    """What ``migrate`` or ``adopt`` of a state is given: who had it, its version, its plain values."""

    node_class: str
    version: int
    values: dict[str, Any]


def first_state(state_class: type[State], where: str) -> State:
    """Return the default state through its bytes, so that no two nodes share a default array."""
    try:
        return decode_any(state_class, encode_any(state_class()), writable=True)
    except (SchemaMismatch, TypeError, ValueError) as error:
        raise GraphError(f"{where}: {state_class.__name__} cannot be handed over: {error}") from error


def state_identity(state_class: type[State]) -> tuple[str, int]:
    """Return the name and the version of a type of states, by which another class knows it for its own."""
    return f"{state_class.__module__}:{state_class.__qualname__}", state_class.version


def adopt_state(state_class: type[State], node_class: str, hand_over: HandOver) -> State:
    """Decode a predecessor's state into ``state_class``.

    The same node class and version decode as they are; an older version goes through ``migrate``, another
    class through ``adopt``. One that has no ``adopt`` takes a state of its own type as it is.
    """
    same_class = hand_over.node_class == node_class
    if same_class and hand_over.state_version == state_class.version:
        return decode_any(state_class, hand_over.state, writable=True)
    hook = getattr(state_class, "migrate" if same_class else "adopt", None)
    if hook is None and (hand_over.state_class, hand_over.state_version) == state_identity(state_class):
        return decode_any(state_class, hand_over.state, writable=True)
    if hook is None:
        needed = f"migrate (from version {hand_over.state_version})" if same_class else "adopt"
        raise SchemaMismatch(
            f"{state_class.__name__} cannot take the state of {hand_over.node_class}: define {needed} on it"
        )
    values = decode_any(dict[str, Any], hand_over.state)
    state = hook(Predecessor(hand_over.node_class, hand_over.state_version, values))
    if not isinstance(state, state_class):
        raise SchemaMismatch(f"{state_class.__name__}.{hook.__name__} returned {type(state).__name__}")
    return decode_any(state_class, encode_any(state), writable=True)
