"""Run one node: one handler at a time, timers in declaration order, then messages as they are given.

The executor knows nothing of sockets. Its driver hands in frames and time and takes frames out, so the same
code runs a node in its own process, in composition and on a test bench.
"""

import base64
import logging
import operator
from collections import deque
from collections.abc import Callable, Collection, Mapping
from types import MappingProxyType
from typing import Any

import msgspec

from palp_core.errors import BagError, GraphError, NodeError, SchemaMismatch, in_words
from palp_core.graph.clock import Clock
from palp_core.graph.log_format import ENDING
from palp_core.graph.messages.builtin import Order
from palp_core.graph.messages.frame import Frame, parse, raw_of
from palp_core.graph.messages.message import Message, decode, encode, encode_any
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.bindings import Bindings
from palp_core.graph.node.handover import VERSION, HandOver, adopt_state, first_state, state_identity
from palp_core.graph.node.journal import BATCH, ORDER_PORT, OUTSIDE, PARAMETERS, Journal
from palp_core.graph.node.lifecycle import Lifecycle, LifecycleHooks, Transition, successor
from palp_core.graph.node.node import Node, Params, State, class_name, declaration_of
from palp_core.graph.node.params import changed_params, load_params
from palp_core.graph.node.ports import Srv
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.qos_events import EventEnd, EventPublisher
from palp_core.graph.node.spec import NodeSpec, topic
from palp_core.graph.node.subscription import Subscription
from palp_core.graph.rng import rng_from_text, rng_of, rng_to_text

_MERGED = ("timers", "events", "served", "sent", "consumed", "published")


class Executor:
    """One node between its driver and its handlers."""

    def __init__(
        self,
        node_class: type[Node],
        spec: NodeSpec,
        clock: Clock,
        send: Callable[[bytes], None],
        *,
        resend: Callable[[bytes], None] | None = None,
    ) -> None:
        self.spec, self.name, self.epoch = spec, spec.name, spec.epoch
        self.lifecycle = Lifecycle.UNCONFIGURED
        self.publishing = False
        self.paused = False  # at a handler boundary, until it is clear which process goes on with the node
        self.exit_code: int | None = None
        self.swaps: list[dict[str, Any]] = []
        self.inbox: deque[Frame] = deque()  # what waits for the node to be active
        self.log = logging.getLogger(f"palp.{spec.name}")
        self.rng = rng_of(spec.seed, spec.name)
        self.resend: Callable[[bytes], None] = resend or (lambda _: None)
        self._clock, self._now_ns = clock, 0
        node_class = node_class.shaped(spec.name, spec.params)
        self.declaration = declaration_of(node_class)
        self.node = node_class(self)
        self.node.params = load_params(self.declaration, spec.params, self.name)
        self.node.state = first_state(self.declaration.state, self.name)
        self.events = EventPublisher(self, send)
        self.ends = Bindings(self.declaration, spec, self, self.events, send)
        self.ends.publishers[self.events.publisher.topic] = self.events.publisher
        order: PublisherEnd[Order] = self.ends.publisher(topic(self.name, ORDER_PORT), Order, Qos(depth=1))
        self.journal = Journal(order, self.ends.sources(), self._encoded_snapshot)
        for subscriptions in self.ends.subscriptions.values():
            for subscription in subscriptions:
                subscription.index = self.journal.index[subscription.source]

    # What the node and its ports ask for

    def now_ns(self) -> int:
        return self._now_ns

    def finish(self, exit_code: int) -> None:
        """End the node's work: timers stop, and whatever still arrives is dropped."""
        self.exit_code = operator.index(exit_code)

    # Lifecycle

    @property
    def is_active(self) -> bool:
        """Whether the node is active, or paused when it was."""
        return self.lifecycle is Lifecycle.ACTIVE or self.paused

    def transition(self, transition: Transition) -> None:
        if transition is Transition.SHUTDOWN and self.lifecycle is Lifecycle.FINALIZED:
            return
        self.resume()
        target = successor(self.lifecycle, transition)
        self._now_ns = self._clock.now_ns()
        if transition is Transition.ACTIVATE:
            self.publishing = True
            self.ends.activate(self._now_ns)
            self._state_bytes()  # one that cannot be handed over is found now, not at a swap
        noted = self.journal.note_transition(transition, self._now_ns)
        if transition is Transition.SHUTDOWN and self.lifecycle is Lifecycle.ACTIVE:
            self.run_hook("on_deactivate")
        self.run_hook(f"on_{transition.value}")
        if transition in (Transition.DEACTIVATE, Transition.SHUTDOWN):
            if self.lifecycle is Lifecycle.ACTIVE:
                self.ends.abandon_goals(f"{self.name} was deactivated")
            self.journal.flush(self._now_ns)
            self.publishing = False
        before, self.lifecycle = self.lifecycle, target
        if noted:
            data = {"transition": transition.value, "from": before.value, "to": target.value}
            self.events.publish("transition", f"{before.value} -> {target.value}", data)

    def pause(self) -> None:
        """Take up and publish nothing more, at a handler boundary; no hook runs."""
        if self.lifecycle is Lifecycle.ACTIVE:
            self._switch(Lifecycle.INACTIVE, paused=True)

    def resume(self) -> None:
        """Go on after :meth:`pause`."""
        if self.paused:
            self._switch(Lifecycle.ACTIVE)

    def _switch(self, lifecycle: Lifecycle, *, paused: bool = False) -> None:
        self.paused, self.lifecycle, self.publishing = paused, lifecycle, lifecycle is Lifecycle.ACTIVE

    # Timers

    def next_due_ns(self) -> int | None:
        if self.lifecycle is not Lifecycle.ACTIVE or self.exit_code is not None:
            return None
        soonest = None
        for end in self.ends.timed.values():  # a generator would cost more than what it goes through
            due_ns = end.due_ns
            if due_ns is not None and (soonest is None or due_ns < soonest):
                soonest = due_ns
        return soonest

    def run_timers(self) -> None:
        """Run everything that is due, once each, in declaration order."""
        if self.lifecycle is not Lifecycle.ACTIVE:
            return
        now_ns = self._clock.now_ns()
        for name, end in self.ends.timed.items():
            due_ns = end.due_ns
            if due_ns is not None and due_ns <= now_ns and self.exit_code is None:
                self.run_timer(name)

    def run_timer(self, name: str, recorded: int | None = None) -> int:
        """Run one timer, alarm or event now, due or not; return its tick number or total count."""
        end = self.ends.timed[name]
        self.begin_request()
        k = end.tick()
        if recorded is not None and isinstance(end, EventEnd):
            end.recall(recorded)
            k = recorded
        self.journal.note(f"timer:{name}", 0, k, self._now_ns)
        try:
            end.handle()
        except BaseException as error:
            raise self._handler_failed(end.port, end.handler, error) from error
        return k

    # Messages

    def consume(self, raw: bytes | Frame) -> None:
        """Take one frame; one that comes before the node is active waits in the inbox."""
        try:
            frame = raw if isinstance(raw, Frame) else parse(raw)
        except SchemaMismatch as error:
            self.events.reject(error)
            return
        if self.lifecycle is not Lifecycle.ACTIVE:
            self.inbox.append(frame)
            return
        if self.exit_code is not None:
            return
        subscriptions = self.ends.subscriptions.get(frame.topic)
        if not subscriptions:
            self.events.reject(SchemaMismatch(f"topic {frame.topic} is not an input of {self.name}"))
            return
        now_ns = self._clock.now_ns()
        for subscription in subscriptions:
            if not self.deliver(subscription, frame, now_ns):
                return  # another subscription to the topic would reject it, too

    def deliver(self, subscription: Subscription, frame: Frame, now_ns: int) -> bool:
        """Account for a message that is due at an active node, write it down and hand it to its handler.

        Every message comes this way, in lockstep, on the wall clock and on a test bench. One that is not what
        the edge carries is counted in ``rejected_count``, logged and dropped.

        Returns:
            False if the message was rejected.
        """
        self._now_ns, journal = now_ns, self.journal
        if now_ns >= journal.next_snapshot_ns:
            journal.take_snapshot(now_ns)
        try:
            message = subscription.accept(frame, now_ns)
        except SchemaMismatch as error:
            place = f"topic {subscription.topic}, input '{subscription.port}'"
            self.events.reject(SchemaMismatch(f"{place}: {error}; fix what its publisher sends"))
            return False
        if message is not None:
            entries = journal.entries  # a call costs more than the entry
            entries.append((subscription.index, frame.epoch, frame.sequence, now_ns))
            if len(entries) >= BATCH:
                journal.flush(now_ns)
            subscription.last = (now_ns, message)
            try:
                subscription.handler(self.node, message)
            except BaseException as error:
                raise self._handler_failed(subscription.port, subscription.handler, error) from error
        return True

    # Requests from outside the graph

    def begin_request(self) -> None:
        """Give a timer, or a request from outside, the present time and a place in the order."""
        self._now_ns = self._clock.now_ns()
        if self._now_ns >= self.journal.next_snapshot_ns:
            self.journal.take_snapshot(self._now_ns)

    def set_parameters(self, changes: dict[str, Any]) -> None:
        self.begin_request()
        node = self.node
        params = changed_params(self.declaration, node.params, changes, self.name)
        wrong = node.examine(params)
        if wrong:  # what was so at the start, or has become so since, is nothing that the change does
            wrong = {name: why for name, why in wrong.items() if node.examine(node.params).get(name) != why}
        if wrong:
            text = "; ".join(f"{name}: {why}" if name else why for name, why in wrong.items())
            raise GraphError(f"{self.name} refuses the parameters: {text}")
        try:
            node.on_parameters(params)
        except ValueError as error:
            raise GraphError(f"{self.name} refuses the parameters: {error}") from error
        before, after = msgspec.to_builtins(node.params), msgspec.to_builtins(params)
        node.params = params
        for end in self.ends.timed.values():
            end.retime(self._now_ns)
        self.journal.note_change(PARAMETERS, changes, self._now_ns)
        changed = {name: [before[name], value] for name, value in after.items() if before[name] != value}
        if changed:
            text = ", ".join(f"{name} = {new}" for name, (_, new) in changed.items())
            self.events.publish("parameters", text, changed)

    def call_service(self, service: str, request: Message) -> Message:
        """Answer a call from outside the graph; the caller sees to it that it is made once."""
        self.begin_request()
        written = base64.b64encode(encode(request)).decode()
        self.journal.note_change(f"{OUTSIDE}{service}", {"request": written}, self._now_ns)
        handler = self.declaration.handlers[service]
        try:
            reply: Message = handler(self.node, request)
        except BaseException as error:
            raise self._handler_failed(service, handler, error) from error
        return reply

    def recorded_request(self, service: str, written: str) -> Message:
        request: Message = decode(self.declaration.of(Srv)[service].request, base64.b64decode(written))
        return request

    # Hand-over

    def _state_bytes(self) -> bytes:
        """Return the encoded state; a node with one that cannot be written down fails."""
        try:
            if not isinstance(self.node.state, State):
                raise TypeError(f"it is {self.node.state!r:.60}, no State")
            return encode_any(self.node.state)
        except (SchemaMismatch, TypeError, ValueError, OverflowError) as error:
            raise self._fail(error, f"its state cannot be written down: {error}") from error

    def snapshot(self) -> HandOver:
        state = self._state_bytes()
        state_class, state_version = state_identity(type(self.node.state))
        return HandOver(
            node_class=class_name(type(self.node)),
            state_class=state_class,
            state_version=state_version,
            state=state,
            params=msgspec.to_builtins(self.node.params),
            epoch=self.epoch,
            now_ns=self._now_ns,
            inbox=[],
            history={},
            rng=rng_to_text(self.rng),
            active=self.is_active,
            finished=self.exit_code is not None,
            swaps=list(self.swaps),
            **self.ends.write_down(),
        )

    def _encoded_snapshot(self) -> bytes:
        return encode_any(self.snapshot())

    def full_snapshot(self, *, with_latest: bool = False) -> HandOver:
        """Return everything a successor needs, of a node that goes on."""
        inbox = [raw_of(frame) for frame in self.inbox]
        latest = self.ends.latest() if with_latest else []
        return msgspec.structs.replace(self.snapshot(), inbox=inbox, history=self._history(), latest=latest)

    def _history(self) -> dict[str, list[bytes]]:
        return {name: list(end.history) for name, end in self.ends.publishers.items() if end.history}

    def hand_over(self) -> HandOver:
        self.journal.flush(self._now_ns)
        return self.full_snapshot()

    def fitting(self, hand_over: HandOver, changes: Mapping[str, Any]) -> tuple[State, Params | None]:
        """Return state and parameters as the node would take them over; no parameters: its own stay."""
        if hand_over.version != VERSION:
            raise SchemaMismatch(
                f"hand-over version {hand_over.version}; this process uses {VERSION}: update the older one"
            )
        own_class = class_name(type(self.node))
        state = adopt_state(self.declaration.state, own_class, hand_over)
        if hand_over.node_class != own_class:
            return state, None
        known = self.declaration.params.__struct_fields__  # another version of the class may have others
        kept = {name: value for name, value in hand_over.params.items() if name in known}
        return state, load_params(self.declaration, kept | dict(changes), self.name)

    def take_over(self, hand_over: HandOver, changes: Mapping[str, Any] = MappingProxyType({})) -> None:
        """Continue where another executor stopped: state, sequences, timers, randomness, unread inbox.

        The node must be configured and inactive; afterwards it is what its predecessor was. ``on_resume`` is
        run instead of ``on_activate``. A predecessor of the same class hands its parameters over too, live
        changes included; ``changes`` are those that are to be others.
        """
        target = successor(self.lifecycle, Transition.ACTIVATE)
        state, params = self.fitting(hand_over, changes)
        if params is not None:
            self.node.params = params
        self.swaps = list(hand_over.swaps)
        self.epoch = hand_over.epoch
        self._continue_from(hand_over, state)
        self.inbox.extend(map(parse, hand_over.inbox))
        if hand_over.active:
            self.publishing = True
            self.run_hook("on_resume")
            self.lifecycle = target
            self.journal.take_snapshot(hand_over.now_ns)

    def _continue_from(self, hand_over: HandOver, state: State) -> None:
        self.node.state, self.rng, self._now_ns = state, rng_from_text(hand_over.rng), hand_over.now_ns
        self.ends.resume(hand_over)

    def restore(self, hand_over: HandOver) -> None:
        self.node.state = adopt_state(self.declaration.state, class_name(type(self.node)), hand_over)
        self.rng = rng_from_text(hand_over.rng)
        self.run_hook("on_restore")

    def dry_run(self, hand_over: HandOver, changes: Mapping[str, Any]) -> HandOver:
        """Take over, handle the last message of every input, and be inactive as before.

        The caller keeps back what is published meanwhile.

        Returns:
            What this has led to, written down as for a successor.
        """
        self.take_over(msgspec.structs.replace(hand_over, inbox=[]), changes)
        for name, payload in hand_over.latest if hand_over.active else ():
            for subscription in self.ends.subscriptions.get(name, []):
                message = subscription.decode(payload)
                subscription.last = (self._now_ns, message)
                try:
                    subscription.handler(self.node, message)
                except (Exception, SystemExit) as error:
                    handler = subscription.handler.__name__
                    text = f"{handler} failed when it was tried on the last message of {name}"
                    raise GraphError(f"{text}: {in_words(error)}") from error
        found = self.snapshot()
        self.step_back()
        return found

    def step_back(self) -> None:
        """Be no more than ready to take over, after work that nothing has read."""
        self.pause()
        self.paused = False
        self.exit_code = None
        self.journal.discard()

    def take_back(self, hand_over: HandOver, ends: Collection[str]) -> None:
        """Go on, after :meth:`pause`, from where a successor had come that was taken back.

        State and randomness are the successor's, and of each port that it has, too, what there is to know;
        the other ports, the parameters, and what was published as far as it has not written that down, are as
        they were. ``on_resume`` is run.
        """
        state = adopt_state(self.declaration.state, class_name(type(self.node)), hand_over)
        self._continue_from(self._with_own_ports(hand_over, ends), state)
        self.publishing = True
        self.run_hook("on_resume")
        self.resume()
        self.journal.take_snapshot(hand_over.now_ns)

    def _with_own_ports(self, hand_over: HandOver, ends: Collection[str]) -> HandOver:
        """Return a successor's hand-over with what it cannot know: of the ports that only this class has."""
        own, theirs = self.ends.write_down(), msgspec.structs.asdict(hand_over)
        merged = {name: own[name] | theirs[name] for name in _MERGED}
        for name in ("alarms", "calls"):  # only what is set is written down
            merged[name] = {end: value for end, value in own[name].items() if end not in ends} | theirs[name]
        merged["idle"] = [name for name in own["idle"] if name not in hand_over.published] + hand_over.idle
        return msgspec.structs.replace(hand_over, history=self._history() | hand_over.history, **merged)

    def leave(self) -> None:
        """End a node that another process goes on with: the hooks of the safe end run and publish nothing."""
        hooks = ("on_deactivate", "on_shutdown") if self.is_active else ("on_shutdown",)
        self._switch(Lifecycle.FINALIZED)
        for hook in hooks:
            try:
                self.run_hook(hook)
            except NodeError as error:  # nothing waits for it any more
                self.log.warning("while it was leaving: %s", error)

    # Failures

    def run_hook(self, name: str) -> None:
        hooks: LifecycleHooks = self.node
        try:
            getattr(hooks, name)()
        except BaseException as error:
            raise self._fail(error, f"{name} failed: {in_words(error)}") from error

    def _handler_failed(
        self, port: str, handler: Callable[..., Any] | None, error: BaseException
    ) -> NodeError:
        name = getattr(handler, "__name__", "the runtime")
        return self._fail(error, f"{name} (handler of '{port}') failed: {in_words(error)}")

    def _fail(self, error: BaseException, text: str) -> NodeError:
        """Finalize the node, its safe state reached, and log why, with the trace; return what to raise."""
        if isinstance(error, KeyboardInterrupt):  # it is the user's
            raise error
        self.log.critical("%s", text, exc_info=None if isinstance(error, BagError) else error, extra=ENDING)
        reason = error if isinstance(error, Exception) else NodeError(self.name, in_words(error))
        self.lifecycle = Lifecycle.FINALIZED
        hooks: list[Callable[[], None]] = [
            lambda: self.node.on_error(reason),
            self.node.on_deactivate,
            lambda: self.ends.abandon_goals(f"{self.name} failed: {text}"),
        ]
        for hook in hooks:
            try:
                hook()
            except KeyboardInterrupt:
                raise
            except BaseException:
                self.log.exception("a hook failed while the node was failing")
        self.journal.flush(self._now_ns)
        self.publishing = False
        return NodeError(self.name, text)
