"""Try a node on what its predecessor has handled last, before it takes over."""

from collections.abc import Mapping
from typing import Any

import msgspec

from palp_core.errors import GraphError, in_words
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver


def try_hand_over(executor: Executor, hand_over: HandOver, changes: Mapping[str, Any]) -> HandOver:
    """Let a node handle the last message of every input on a copy of a predecessor's state, and be as before.

    The caller keeps back what is published meanwhile.

    Args:
        executor: The node, which is configured and inactive.
        hand_over: The predecessor's; without ``latest`` the state alone is tried.
        changes: Parameters that are to be others.

    Returns:
        The state that this has led to, written down as for a successor.
    """
    executor.take_over(msgspec.structs.replace(hand_over, inbox=[]), changes)
    for name, payload in hand_over.latest if hand_over.active else ():
        for subscription in executor.ends.subscriptions.get(name, []):
            message = subscription.decode(payload)
            subscription.last = (executor.now_ns(), message)
            try:
                subscription.handler(executor.node, message)
            except (Exception, SystemExit) as error:
                handler = subscription.handler.__name__
                text = f"{handler} failed when it was tried on the last message of {name}"
                raise GraphError(f"{text}: {in_words(error)}") from error
    found = executor.snapshot()
    executor.step_back()
    return found
