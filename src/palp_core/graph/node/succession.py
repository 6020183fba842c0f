"""Between an executor and its hand-over: write down all of one, and set another to it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import msgspec

from palp_core.errors import NodeError, SchemaMismatch
from palp_core.graph.messages.frame import parse, raw_of
from palp_core.graph.node.handover import VERSION, HandOver, adopt_state
from palp_core.graph.node.lifecycle import Lifecycle, Transition, successor
from palp_core.graph.node.node import Params, State, class_name
from palp_core.graph.node.params import load_params
from palp_core.graph.node.rng import rng_from_text, rng_to_text

if TYPE_CHECKING:
    from palp_core.graph.node.executor import Executor


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
        active=executor.is_active,
        finished=executor.exit_code is not None,
        swaps=list(executor.swaps),
        **executor.ends.write_down(),
    )


def hand_over_of(executor: Executor) -> HandOver:
    """Return everything a successor needs."""
    return msgspec.structs.replace(
        snapshot(executor),
        inbox=[raw_of(frame) for frame in executor.inbox],
        history={name: out.remembered() for name, out in executor.ends.publishers.items() if out.history},
    )


def fitting(
    executor: Executor, hand_over: HandOver, changes: Mapping[str, Any]
) -> tuple[State, Params | None]:
    """Return state and parameters as an executor would take them over; no parameters: its own stay.

    Raises:
        SchemaMismatch: The hand-over is of another version, or its state does not fit the class.
        GraphError: The parameters do not fit.
    """
    if hand_over.version != VERSION:
        raise SchemaMismatch(f"a hand-over of version {hand_over.version}; this end speaks {VERSION}")
    own_class = class_name(type(executor.node))
    state = adopt_state(executor.declaration.state, own_class, hand_over)
    if hand_over.node_class != own_class:
        return state, None
    known = executor.declaration.params.__struct_fields__  # another version of the class may have others
    kept = {name: value for name, value in hand_over.params.items() if name in known}
    return state, load_params(executor.declaration, kept | dict(changes), executor.name)


def adopt(executor: Executor, hand_over: HandOver, changes: Mapping[str, Any]) -> None:
    """Set an executor to what another one has written down.

    Raises:
        SchemaMismatch, GraphError: It does not fit the class; nothing has changed.
    """
    node = executor.node
    state, params = fitting(executor, hand_over, changes)
    if params is not None:
        node.params = params
    node.state = state
    executor.swaps = list(hand_over.swaps)
    executor.rng = rng_from_text(hand_over.rng)
    executor.epoch = hand_over.epoch
    executor.ends.resume(hand_over)


def take_over(executor: Executor, hand_over: HandOver, changes: Mapping[str, Any]) -> None:
    """See :meth:`palp_core.graph.node.executor.Executor.take_over`."""
    target = successor(executor.lifecycle, Transition.ACTIVATE)
    adopt(executor, hand_over, changes)
    executor.set_time(hand_over.now_ns)
    executor.inbox.extend(map(parse, hand_over.inbox))
    if not hand_over.active:
        return
    executor.publishing = True
    executor.failing.hook("on_resume")
    executor.lifecycle = target
    executor.order.begin(hand_over.now_ns)


def leave(executor: Executor) -> None:
    """See :meth:`palp_core.graph.node.executor.Executor.leave`."""
    hooks = ("on_deactivate", "on_shutdown") if executor.is_active else ("on_shutdown",)
    executor.paused, executor.publishing, executor.lifecycle = False, False, Lifecycle.FINALIZED
    for hook in hooks:
        try:
            executor.failing.hook(hook)
        except NodeError as error:  # nobody waits for it any more
            executor.log.warning("while it was leaving: %s", error)
