"""A node's change of hands at a handler boundary: it is written down, and another goes on from there."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import msgspec

from palp_core.errors import NodeError, SchemaMismatch
from palp_core.graph.messages.frame import parse, raw_of
from palp_core.graph.messages.message import encode_any
from palp_core.graph.node.handover import VERSION, HandOver, adopt_state, state_identity
from palp_core.graph.node.lifecycle import Lifecycle, Transition, successor
from palp_core.graph.node.node import Params, State, class_name
from palp_core.graph.node.params import load_params
from palp_core.graph.rng import rng_from_text, rng_to_text

if TYPE_CHECKING:
    from palp_core.graph.node.executor import Executor

_MERGED = ("timers", "events", "served", "sent")


class Succession:
    """A node's change of hands at a handler boundary: it is written down, and another goes on from there.

    Args:
        executor: The node's.

    Attributes:
        paused: At a boundary, until it is clear who goes on.
    """

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self.paused = False

    @property
    def is_active(self) -> bool:
        """Whether the node is at work, or paused in it."""
        return self._executor.lifecycle is Lifecycle.ACTIVE or self.paused

    def pause(self) -> None:
        """Take up and publish nothing more, at a handler boundary; no hook runs."""
        if self._executor.lifecycle is Lifecycle.ACTIVE:
            self._switch(Lifecycle.INACTIVE, paused=True)

    def resume(self) -> None:
        """Go on after :meth:`pause`."""
        if self.paused:
            self._switch(Lifecycle.ACTIVE)

    def _switch(self, lifecycle: Lifecycle, *, paused: bool = False) -> None:
        self.paused = paused
        self._executor.lifecycle, self._executor.publishing = lifecycle, lifecycle is Lifecycle.ACTIVE

    def state_bytes(self) -> bytes:
        """Return the encoded state.

        Raises:
            NodeError: It holds what cannot be written down; the node has failed.
        """
        executor = self._executor
        try:
            return encode_any(executor.node.state)
        except (SchemaMismatch, TypeError, ValueError, OverflowError) as error:
            text = f"its state cannot be written down: {error}"
            executor.failing.fail(error, text)
            raise NodeError(executor.name, text) from error

    def snapshot(self) -> HandOver:
        """Return the hand-over without inbox and histories."""
        executor = self._executor
        state_class, state_version = state_identity(type(executor.node.state))
        return HandOver(
            node_class=class_name(type(executor.node)),
            state_class=state_class,
            state_version=state_version,
            state=self.state_bytes(),
            params=msgspec.to_builtins(executor.node.params),
            epoch=executor.epoch,
            now_ns=executor.now_ns(),
            inbox=[],
            history={},
            rng=rng_to_text(executor.rng),
            active=self.is_active,
            finished=executor.exit_code is not None,
            swaps=list(executor.swaps),
            **executor.ends.write_down(),
        )

    def copy(self, *, with_latest: bool = False) -> HandOver:
        """Return everything a successor needs, of a node that goes on.

        Args:
            with_latest: The last message of every input, too, on which it is to be tried.
        """
        executor = self._executor
        inbox = [raw_of(frame) for frame in executor.inbox]
        latest = executor.ends.latest() if with_latest else []
        return msgspec.structs.replace(self.snapshot(), inbox=inbox, history=self._history(), latest=latest)

    def _history(self) -> dict[str, list[bytes]]:
        publishers = self._executor.ends.publishers.items()
        return {name: list(end.history) for name, end in publishers if end.history}

    def hand_over(self) -> HandOver:
        """Return everything a successor needs, its journal closed."""
        self._executor.journal.flush(self._executor.now_ns())
        return self.copy()

    def fitting(self, hand_over: HandOver, changes: Mapping[str, Any]) -> tuple[State, Params | None]:
        """Return state and parameters as the node would take them over; no parameters: its own stay.

        Raises:
            SchemaMismatch: The hand-over is of another version, or its state does not fit the class.
            GraphError: The parameters do not fit.
        """
        executor = self._executor
        if hand_over.version != VERSION:
            raise SchemaMismatch(f"a hand-over of version {hand_over.version}; this end speaks {VERSION}")
        own_class = class_name(type(executor.node))
        state = adopt_state(executor.declaration.state, own_class, hand_over)
        if hand_over.node_class != own_class:
            return state, None
        known = executor.declaration.params.__struct_fields__  # another version of the class may have others
        kept = {name: value for name, value in hand_over.params.items() if name in known}
        return state, load_params(executor.declaration, kept | dict(changes), executor.name)

    def take_over(self, hand_over: HandOver, changes: Mapping[str, Any] = MappingProxyType({})) -> None:
        """Continue where another executor stopped: state, sequences, timers, randomness, unread inbox.

        The node must be configured and inactive; afterwards it is what its predecessor was. ``on_resume`` is
        run instead of ``on_activate``. A predecessor of the same class hands its parameters over too, live
        changes included; ``changes`` are those that are to be others.

        Raises:
            SchemaMismatch, GraphError: State or parameters do not fit this class; nothing has changed.
            LifecycleError: The node is not inactive.
            NodeError: The hook failed.
        """
        executor = self._executor
        target = successor(executor.lifecycle, Transition.ACTIVATE)
        state, params = self.fitting(hand_over, changes)
        if params is not None:
            executor.node.params = params
        executor.node.state = state
        executor.swaps = list(hand_over.swaps)
        executor.rng = rng_from_text(hand_over.rng)
        executor.epoch = hand_over.epoch
        executor.ends.resume(hand_over)
        executor.set_time(hand_over.now_ns)
        executor.inbox.extend(map(parse, hand_over.inbox))
        if hand_over.active:
            executor.publishing = True
            executor.failing.hook("on_resume")
            executor.lifecycle = target
            executor.journal.take_snapshot(hand_over.now_ns)

    def step_back(self) -> None:
        """Be no more than ready to take over, after work that nobody has heard."""
        executor = self._executor
        self.pause()
        self.paused = False
        executor.exit_code = None
        executor.journal.discard()

    def take_back(self, hand_over: HandOver, ends: Collection[str]) -> None:
        """Go on, after :meth:`pause`, from where a successor had come that was taken back.

        State and randomness are the successor's, and of each port that it has, too, what there is to know;
        the other ports, the parameters, and what was published as far as it has not written that down, are as
        they were. ``on_resume`` is run.

        Args:
            hand_over: The successor's.
            ends: Names of its timers, alarms, events and clients.

        Raises:
            SchemaMismatch: The state does not fit this class; nothing has changed.
            NodeError: The hook failed.
        """
        executor = self._executor
        own_class = class_name(type(executor.node))
        executor.node.state = adopt_state(executor.declaration.state, own_class, hand_over)
        executor.rng = rng_from_text(hand_over.rng)
        executor.ends.resume(self._with_own_ports(hand_over, ends))
        executor.set_time(hand_over.now_ns)
        executor.publishing = True
        executor.failing.hook("on_resume")
        self.resume()
        executor.journal.take_snapshot(hand_over.now_ns)

    def _with_own_ports(self, hand_over: HandOver, ends: Collection[str]) -> HandOver:
        """Return a successor's hand-over with what it cannot know: of the ports that only this class has."""
        own = self._executor.ends.write_down()
        theirs = msgspec.structs.asdict(hand_over)
        merged = {name: own[name] | theirs[name] for name in (*_MERGED, "consumed", "published")}
        for name in ("alarms", "calls"):  # only what is set is written down
            merged[name] = {end: value for end, value in own[name].items() if end not in ends} | theirs[name]
        idle = [name for name in own["idle"] if name not in hand_over.published] + hand_over.idle
        history = self._history() | hand_over.history
        return msgspec.structs.replace(hand_over, history=history, idle=idle, **merged)

    def leave(self) -> None:
        """End a node that another process goes on with: the hooks of the safe end run and publish nothing."""
        executor = self._executor
        hooks = ("on_deactivate", "on_shutdown") if self.is_active else ("on_shutdown",)
        self._switch(Lifecycle.FINALIZED)
        for hook in hooks:
            try:
                executor.failing.hook(hook)
            except NodeError as error:  # nobody waits for it any more
                executor.log.warning("while it was leaving: %s", error)
