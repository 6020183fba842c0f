"""Between an executor and its hand-over: write down all of one, and set another to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from palp_core.runtime.handover import HandOver, adopt_state
from palp_core.runtime.node import class_name
from palp_core.runtime.params import load_params
from palp_core.runtime.randomness import rng_from_text, rng_to_text
from palp_core.runtime.wire import raw_of

if TYPE_CHECKING:
    from palp_core.runtime.executor import Executor

__all__ = ["adopt", "hand_over_of", "snapshot"]


def snapshot(executor: Executor) -> HandOver:
    """Return the hand-over without inbox and histories."""
    return HandOver(
        node_class=class_name(type(executor.node)),
        state_version=type(executor.node.state).version,
        state=executor.state_bytes(),
        params=msgspec.to_builtins(executor.node.params),
        epoch=executor.epoch,
        now_ns=executor.now_ns(),
        inbox=[],
        history={},
        rng=rng_to_text(executor.rng),
        **executor.ends.write_down(),
    )


def hand_over_of(executor: Executor) -> HandOver:
    """Return everything a successor needs."""
    return msgspec.structs.replace(
        snapshot(executor),
        inbox=[raw_of(frame) for frame in executor.inbox],
        history={name: out.remembered() for name, out in executor.outlets.items() if out.history},
    )


def adopt(executor: Executor, hand_over: HandOver) -> None:
    """Set an executor to what another one has written down.

    Raises:
        SchemaMismatch: The state does not fit the class; nothing has changed.
    """
    node, declared = executor.node, executor.declaration
    own_class = class_name(type(node))
    state = adopt_state(declared.state, own_class, hand_over)
    if hand_over.node_class == own_class:
        node.params = load_params(declared, hand_over.params, executor.name)
    node.state = state
    executor.rng = rng_from_text(hand_over.rng)
    executor.epoch = hand_over.epoch
    executor.ends.resume(hand_over)
