"""Connect what a node class declares to live ends: publishers, subscriptions, clients, timers and alarms."""

from __future__ import annotations

import copy
import functools
import itertools
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import msgspec

from palp_core.graph.actions.client import ActionClientEnd, SentGoals
from palp_core.graph.actions.server import ActionServerEnd
from palp_core.graph.messages.message import Message, encode_any
from palp_core.graph.messages.qos import EventKind, Qos, events_of
from palp_core.graph.node.action_parts import CALLS
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.node import Declaration, Node
from palp_core.graph.node.ports import Alarm, Timer
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.qos_events import EventEnd, QosEvent
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.node.service_client import ClientEnd
from palp_core.graph.node.spec import NodeSpec, part, topic
from palp_core.graph.node.subscription import ReplySubscription, RequestSubscription, Subscription
from palp_core.graph.node.timers import AlarmEnd, TimerEnd

if TYPE_CHECKING:
    from palp_core.graph.node.executor import Executor

Guard = Callable[[str, Callable[..., Any]], Callable[..., Any]]
TimedEnd = TimerEnd | AlarmEnd | EventEnd | ClientEnd | ActionServerEnd
SERVICE = Qos(depth=100)


class Bindings:
    """The live ends of one node; puts them in place of the declarations on the instance.

    Args:
        declared: What the class declares.
        spec: The node's place in the graph.
        owner: The node's executor.
        guard: Wraps a handler so that its failure is the node's.
        send: Takes each published frame.
    """

    def __init__(
        self,
        declared: Declaration,
        spec: NodeSpec,
        owner: Executor,
        guard: Guard,
        send: Callable[[bytes], None],
    ) -> None:
        self.publishers: dict[str, PublisherEnd[Any]] = {}
        self.subscriptions: dict[str, list[Subscription]] = {}
        self.timers: dict[str, TimedEnd] = {}
        self.action_clients: dict[str, ActionClientEnd] = {}
        self._spec, self._owner, self._send, self._guard = spec, owner, send, guard
        self.services = {name: guard(name, declared.handlers[name]) for name in declared.services}
        handlers = {name: guard(name, handler) for name, handler in declared.handlers.items()}
        self._bind_timers(declared, handlers)
        self._bind_topics(declared)
        self._bind_services(declared)
        self._bind_actions(declared)

    def publisher(
        self, name: str, message: type[Message], qos: Qos, type_hash: int | None = None
    ) -> PublisherEnd[Any]:
        """Add an output; its type is the message's, unless another one is given."""
        made: PublisherEnd[Any] = PublisherEnd(
            name, message, qos, self._spec.epoch, self._owner, self._send, type_hash
        )
        self.publishers[name] = made
        return made

    def _subscribe(self, subscription: Subscription) -> None:
        self.subscriptions.setdefault(subscription.topic, []).append(subscription)

    def _event(self, kind: EventKind, port: str, name: str, declared: Declaration) -> EventEnd:
        handler = declared.event_handlers.get(port)
        guarded = self._guard(port, handler) if handler is not None else None

        def handle(event: QosEvent) -> None:
            self._owner.events.publish_qos_event(event)
            if guarded is not None:
                guarded(event)

        end = EventEnd(kind, port, name, self._owner, handle)
        self.timers[end.name] = end
        return end

    def _bind_topics(self, declared: Declaration) -> None:
        spec, ends = self._spec, self._owner.node.__dict__
        for name, pub in declared.pubs.items():
            ends[name] = made = self.publisher(topic(spec.name, name), pub.message, pub.qos)
            made.tell_lost = self._overrun(name, made, declared)
        for name, (type_hash, qos) in spec.vacant.items():
            self.publisher(name, _Unsaid, qos, int(type_hash, 16))
        for name, sub in declared.subs.items():
            if name not in spec.inputs:
                continue
            source, qos = spec.inputs[name], spec.qos.get(name, sub.qos)
            if name in spec.external:
                self.publisher(source, sub.message, qos)
            subscription = Subscription(
                source, f"input:{name}", name, sub.message, declared.handlers[name], qos
            )
            self._subscribe(subscription)
            kinds: list[EventKind] = ["message_lost", *events_of(qos)]
            subscription.attach({kind: self._event(kind, name, source, declared) for kind in kinds})
            subscription.tell_repeats = functools.partial(self._tell_repeats, name, source)

    def _overrun(self, port: str, out: PublisherEnd[Any], declared: Declaration) -> Callable[[int], None]:
        """Return what hears how many more messages readers have lost; a handler is rung, as in a replay."""
        if port not in declared.event_handlers:
            return functools.partial(self._tell_overrun, port, out)
        end = self._event("reader_overrun", port, out.topic, declared)
        return lambda change: end.count(change, self._owner.now_ns())

    def _tell_overrun(self, port: str, out: PublisherEnd[Any], change: int) -> None:
        event = QosEvent(
            kind="reader_overrun",
            port=port,
            topic=out.topic,
            total_count=out.lost_count,
            count_change=change,
        )
        self._owner.events.publish_qos_event(event)

    def _tell_repeats(self, port: str, name: str, count: int) -> None:
        """Say it, but hand it to no handler: that would be one more thing that a replay must ring again."""
        event = QosEvent(kind="message_repeated", port=port, topic=name, total_count=count, count_change=1)
        self._owner.events.publish_qos_event(event)

    def _bind_services(self, declared: Declaration) -> None:
        """A client's requests are a topic of its own; the replies to it are a topic of the server's."""
        spec, ends = self._spec, self._owner.node.__dict__
        for name, client in declared.clients.items():
            own = topic(spec.name, name)
            requests = self.publisher(own, client.request, SERVICE)
            # The overdue calls ring before the event that says how many of them are given up.
            key = f"timeout:{name}"
            self.timers[key] = ends[name] = end = ClientEnd(
                key,
                requests,
                round(client.timeout_ms * 1e6),
                client.retries,
                self._owner,
                self._given_up(name),
            )
            self._event("call_timeout", name, spec.inputs.get(name, own), declared)
            if name in spec.inputs:
                answers = spec.inputs[name] + own
                replies = ReplySubscription(
                    answers, f"reply:{name}", name, client.reply, declared.handlers[name], SERVICE
                )
                replies.end = end
                self._subscribe(replies)
        for name, service in declared.services.items():
            for client_topic in spec.requests.get(name, []):
                source = f"call:{name}{client_topic}"
                calls = RequestSubscription(
                    client_topic, source, name, service.request, declared.handlers[name], SERVICE
                )
                calls.reply = self.publisher(topic(spec.name, name) + client_topic, service.reply, SERVICE)
                calls.handler = _answer(calls.handler, calls)
                self._subscribe(calls)

    def _bind_actions(self, declared: Declaration) -> None:
        """Put what knows the goals behind the parts of each action, which are bound already."""
        spec, owner = self._spec, self._owner
        for name, act in declared.actions.items():
            steps = self.timers.get(part("step", name))
            assert steps is None or isinstance(steps, TimerEnd)
            feedback, status = (
                self.publishers[topic(spec.name, part(n, name))] for n in ("feedback", "status")
            )
            execute = declared.handlers[name]
            server = ActionServerEnd(
                f"action:{name}", act, owner, feedback, status, execute, declared.roles.get(name, {}), steps
            )
            ring = functools.wraps(execute)(functools.partial(_ring, server))
            server.handle = self._guard(name, ring)
            self.timers[server.name] = owner.node.__dict__[name] = server
        for name, port in declared.action_clients.items():
            ends = {verb: self.timers[f"timeout:{part(verb, name)}"] for verb in CALLS}
            calls = {verb: end for verb, end in ends.items() if isinstance(end, ClientEnd)}
            heard = declared.roles.get(name, {}).get("feedback")
            client = ActionClientEnd(name, port, owner, calls, declared.handlers[name], heard)
            self.action_clients[name] = owner.node.__dict__[name] = client

    @property
    def action_servers(self) -> list[ActionServerEnd]:
        """The live end of every action that the node serves."""
        return [end for end in self.timers.values() if isinstance(end, ActionServerEnd)]

    def abandon_goals(self, why: str) -> None:
        """Abort every goal that the node works on, and say why."""
        for server in self.action_servers:
            for goal in server.goals:
                server.conclude(goal.record, "aborted", why)

    def activate(self, now_ns: int) -> None:
        """Begin: timers start, what was asked before is forgotten."""
        for end in self.timers.values():
            end.activate(now_ns)
        for client in self.action_clients.values():
            client.activate()

    def _given_up(self, name: str) -> Callable[[int], None]:
        def count(change: int) -> None:
            end = self.timers[f"call_timeout:{name}"]
            assert isinstance(end, EventEnd)
            end.count(change, self._owner.now_ns())

        return count

    def _bind_timers(self, declared: Declaration, handlers: dict[str, Callable[..., Any]]) -> None:
        owner = self._owner
        for name in declared.handlers:
            if name in declared.timers:
                timer = declared.timers[name]
                self.timers[name] = TimerEnd(name, self._rate_of(timer), timer.running, owner, handlers[name])
            elif name in declared.alarms:
                self.timers[name] = AlarmEnd(name, owner, handlers[name])
            if isinstance(getattr(type(owner.node), name, None), Timer | Alarm):
                owner.node.__dict__[name] = self.timers[name]

    def _rate_of(self, timer: Timer) -> Callable[[], float]:
        return lambda: float(getattr(self._owner.node.params, timer.hz))

    def sources(self) -> list[str]:
        """Return the name of everything that the node can consume."""
        read = [subscription.source for subscription in self._all_subscriptions()]
        return [*read, *(f"timer:{name}" for name in self.timers), *(f"outside:{n}" for n in self.services)]

    def _all_subscriptions(self) -> Iterator[Subscription]:
        return itertools.chain.from_iterable(self.subscriptions.values())

    @property
    def accounts(self) -> dict[str, SequenceAccount]:
        """Account of every input topic."""
        return {name: subscriptions[0].account for name, subscriptions in self.subscriptions.items()}

    @property
    def topic_of_source(self) -> dict[str, str]:
        """Topic behind each input, reply or call that the node's journal names."""
        return {subscription.source: subscription.topic for subscription in self._all_subscriptions()}

    def counts(self) -> dict[str, int]:
        """Return how many ticks, overruns, missed deadlines and messages lost by readers there were."""
        timers = [end for end in self.timers.values() if isinstance(end, TimerEnd)]
        events = [end for end in self.timers.values() if isinstance(end, EventEnd)]
        return {
            "ticks": sum(end.tick_count for end in timers),
            "overruns": sum(end.overrun_count for end in timers),
            "missed_deadlines": sum(end.total for end in events if end.kind == "deadline"),
            "lost_by_readers": sum(out.lost_count for out in self.publishers.values()),
        }

    def run_count(self) -> int:
        """Return how many messages, ticks and alarms have been handled; a predecessor's messages count."""
        handled = sum(subscription.account.received for subscription in self._all_subscriptions())
        ticks = [end.tick_count for end in self.timers.values() if isinstance(end, TimerEnd | AlarmEnd)]
        return handled + sum(ticks)

    def latest(self) -> list[tuple[str, bytes]]:
        """Return the last message that each topic's reader has handled, the oldest first."""
        handled = [
            (*first.last, name)
            for name, (first, *_) in self.subscriptions.items()
            if first.last is not None and type(first) is Subscription
        ]
        handled.sort(key=lambda one: one[0])
        return [(name, encode_any(message)) for _, message, name in handled]

    def write_down(self) -> dict[str, Any]:
        """Return what a successor must know of these ends, as fields of a hand-over."""
        ends = self.timers.items()
        return {
            "timers": {name: (end.k, end.due_ns) for name, end in ends if isinstance(end, TimerEnd)},
            "alarms": {
                name: e.due_ns for name, e in ends if isinstance(e, AlarmEnd) and e.due_ns is not None
            },
            "events": {name: end.total for name, end in ends if isinstance(end, EventEnd)},
            "calls": {
                name: copy.deepcopy(e.pending) for name, e in ends if isinstance(e, ClientEnd) and e.pending
            },
            "served": {end.name: end.ledger.keep() for end in self.action_servers},
            "sent": {name: client.keep() for name, client in self.action_clients.items()},
            "consumed": {name: msgspec.structs.replace(counter) for name, counter in self.accounts.items()},
            "published": {name: out.sequence for name, out in self.publishers.items()},
            "idle": [name for name, out in self.publishers.items() if out.idle_until_next],
        }

    def resume(self, hand_over: HandOver) -> None:
        """Continue a predecessor's timers, accounts and sequences."""
        for name, end in self.timers.items():
            if isinstance(end, TimerEnd):
                end.resume(hand_over.timers.get(name), hand_over.now_ns)
            elif isinstance(end, AlarmEnd):
                end.resume(hand_over.alarms.get(name))
            elif isinstance(end, EventEnd):
                end.resume(hand_over.events.get(name, 0))
            elif isinstance(end, ActionServerEnd):
                end.resume(hand_over.served.get(name))
            else:
                end.resume(hand_over.calls.get(name, []))
        for name, client in self.action_clients.items():
            client.resume(hand_over.sent.get(name, SentGoals()))
        for name, counter in hand_over.consumed.items():
            for subscription in self.subscriptions.get(name, []):
                subscription.account = msgspec.structs.replace(counter)
        for name, out in self.publishers.items():
            out.resume(hand_over.epoch, hand_over.published.get(name, 0), hand_over.history.get(name, []))
            out.idle_until_next = name in hand_over.idle


class _Unsaid(Message):
    """What the class does not publish: only where the topic's sequence stands is known of it."""


def _ring(server: ActionServerEnd, _node: Node) -> None:
    server.ring()


def _answer(handler: Callable[..., Any], calls: RequestSubscription) -> Callable[..., None]:
    @functools.wraps(handler)
    def answer(node: Node, request: Message) -> None:
        calls.reply.reply(handler(node, request), *calls.current)

    return answer
