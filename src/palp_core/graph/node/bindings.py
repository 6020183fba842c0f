"""Connect what a node class declares to live ends: publishers, subscriptions, clients, timers and alarms."""

from __future__ import annotations

import copy
import functools
import itertools
from collections.abc import Callable, Iterator
from typing import Any

import msgspec

from palp_core.graph.messages.message import Message, encode_any
from palp_core.graph.messages.qos import EventKind, Qos, events_of
from palp_core.graph.node.action_client import ActionClientEnd, SentGoals
from palp_core.graph.node.action_server import ActionServerEnd
from palp_core.graph.node.context import NodeContext
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.node import Declaration, Node
from palp_core.graph.node.ports import (
    ACTION_CALLS,
    SERVICE,
    Act,
    ActionClient,
    Alarm,
    Client,
    Pub,
    Srv,
    Sub,
    Timer,
)
from palp_core.graph.node.publisher import PublisherEnd
from palp_core.graph.node.qos_events import EventEnd, EventPublisher
from palp_core.graph.node.sequence_account import SequenceAccount
from palp_core.graph.node.service_client import ClientEnd
from palp_core.graph.node.spec import NodeSpec, part, topic
from palp_core.graph.node.subscription import ReplySubscription, RequestSubscription, Subscription
from palp_core.graph.node.timers import AlarmEnd, TimedEnd, TimerEnd


class Bindings:
    """The live ends of one node; puts them in place of the declarations on the instance."""

    def __init__(
        self,
        declared: Declaration,
        spec: NodeSpec,
        context: NodeContext,
        events: EventPublisher,
        send: Callable[[bytes], None],
    ) -> None:
        self.publishers: dict[str, PublisherEnd[Any]] = {}
        self.subscriptions: dict[str, list[Subscription]] = {}
        self.timed: dict[str, TimedEnd] = {}  # all that may be due, by its name in the journal, in order
        self.timers: dict[str, TimerEnd] = {}
        self.alarms: dict[str, AlarmEnd] = {}
        self.events: dict[tuple[EventKind, str], EventEnd] = {}
        self.clients: dict[str, ClientEnd[Any]] = {}
        self.action_servers: dict[str, ActionServerEnd[Any, Any, Any]] = {}
        self.action_clients: dict[str, ActionClientEnd[Any]] = {}
        self._declared, self._spec, self._context = declared, spec, context
        self._events, self._send = events, send
        self._bind_timers()
        self._bind_topics()
        self._bind_clients()
        self._bind_services()
        self._bind_actions()

    def publisher(
        self, name: str, message: type[Message], qos: Qos, type_hash: int | None = None
    ) -> PublisherEnd[Any]:
        """Add an output; its type is the message's, unless another one is given."""
        made: PublisherEnd[Any] = PublisherEnd(
            name, message, qos, self._spec.epoch, self._context, self._send, type_hash
        )
        self.publishers[name] = made
        return made

    def _subscribe(self, subscription: Subscription) -> None:
        self.subscriptions.setdefault(subscription.topic, []).append(subscription)

    def _event(self, kind: EventKind, port: str, name: str) -> EventEnd:
        handler = self._declared.event_handlers.get(port)
        end = EventEnd(kind, port, name, self._context, self._events, handler)
        self.events[kind, port] = self.timed[end.name] = end
        return end

    def _bind_timers(self) -> None:
        context = self._context
        for name, handler in self._declared.handlers.items():
            match self._declared.ports[name]:
                case Timer() as timer:
                    end = TimerEnd(name, context, timer.hz, running=timer.running, handler=handler)
                    self.timed[name] = self.timers[name] = end
                case Alarm():
                    self.timed[name] = self.alarms[name] = AlarmEnd(name, name, context, handler)
            if isinstance(getattr(type(context.node), name, None), Timer | Alarm):
                context.node.__dict__[name] = self.timed[name]

    def _bind_topics(self) -> None:
        spec, declared = self._spec, self._declared
        for name, pub in declared.of(Pub).items():
            out = self.publisher(topic(spec.name, name), pub.message, pub.qos)
            self._context.node.__dict__[name] = out
            if name in declared.event_handlers:
                self._event("reader_overrun", name, out.topic)
        for name, (type_hash, qos) in spec.vacant.items():
            self.publisher(name, _UnpublishedMessage, qos, int(type_hash, 16))
        for name, sub in declared.of(Sub).items():
            if name not in spec.inputs:
                continue
            source, qos = spec.inputs[name], spec.qos.get(name, sub.qos)
            if name in spec.external:
                self.publisher(source, sub.message, qos)
            subscription = Subscription(
                source, f"input:{name}", name, sub.message, declared.handlers[name], qos, self._events
            )
            self._subscribe(subscription)
            kinds: list[EventKind] = ["message_lost", *events_of(qos)]
            subscription.event_ends = {kind: self._event(kind, name, source) for kind in kinds}

    def report_overrun(self, out: PublisherEnd[Any], change: int) -> None:
        """Report how many more messages of an output its readers have lost; its handler is rung."""
        port = out.topic.removeprefix(topic(self._spec.name, ""))
        if end := self.events.get(("reader_overrun", port)):
            end.count(change, self._context.now_ns())
        elif isinstance(self._declared.ports.get(port), Pub):
            self._events.publish_qos_event("reader_overrun", port, out.topic, out.lost_count, change)

    def _bind_clients(self) -> None:
        """A client's requests are a topic of its own; the replies to it are a topic of the server's."""
        spec, events = self._spec, self._events
        for name, client in self._declared.of(Client).items():
            own = topic(spec.name, name)
            requests = self.publisher(own, client.request, SERVICE)
            end = ClientEnd[Any](
                name, self._context, requests, round(client.timeout_ms * 1e6), client.retries
            )
            # The overdue calls ring before the event that says how many of them are given up.
            self.timed[end.name] = self.clients[name] = self._context.node.__dict__[name] = end
            end.given_up = self._event("call_timeout", name, spec.inputs.get(name, own))
            if name in spec.inputs:
                answers, handler = spec.inputs[name] + own, self._declared.handlers[name]
                replies = ReplySubscription(
                    answers, f"reply:{name}", name, client.reply, handler, SERVICE, events
                )
                replies.client = end
                self._subscribe(replies)

    def _bind_services(self) -> None:
        spec, events = self._spec, self._events
        for name, service in self._declared.of(Srv).items():
            for client_topic in spec.requests.get(name, []):
                source, handler = f"call:{name}{client_topic}", self._declared.handlers[name]
                calls = RequestSubscription(
                    client_topic, source, name, service.request, handler, SERVICE, events
                )
                calls.reply = self.publisher(topic(spec.name, name) + client_topic, service.reply, SERVICE)
                calls.handler = _answer(handler, calls)
                self._subscribe(calls)

    def _bind_actions(self) -> None:
        declared, context = self._declared, self._context
        for name, act in declared.of(Act).items():
            server = ActionServerEnd[Any, Any, Any](
                name,
                act.types,
                act.when_busy,
                context,
                self.publishers[topic(context.name, part("feedback", name))],
                self.publishers[topic(context.name, part("status", name))],
                declared.handlers[name],
                declared.roles.get(name, {}),
                self.timers.get(part("step", name)),
            )
            self.timed[server.name] = self.action_servers[name] = context.node.__dict__[name] = server
        for name, port in declared.of(ActionClient).items():
            calls = {verb: self.clients[part(verb, name)] for verb in ACTION_CALLS}
            feedback = declared.roles.get(name, {}).get("feedback")
            client = ActionClientEnd[Any](
                name, port.types, port.lease_ms, context, calls, declared.handlers[name], feedback
            )
            self.action_clients[name] = context.node.__dict__[name] = client

    def abandon_goals(self, why: str) -> None:
        for server in self.action_servers.values():
            server.abandon(why)

    def activate(self, now_ns: int) -> None:
        """Begin: timers start, what was asked before is forgotten."""
        for end in self.timed.values():
            end.activate(now_ns)
        for client in self.action_clients.values():
            client.activate()

    def sources(self) -> list[str]:
        read = [subscription.source for subscription in self._all_subscriptions()]
        services = self._declared.of(Srv)
        return [*read, *(f"timer:{name}" for name in self.timed), *(f"outside:{name}" for name in services)]

    def _all_subscriptions(self) -> Iterator[Subscription]:
        return itertools.chain.from_iterable(self.subscriptions.values())

    @property
    def accounts(self) -> dict[str, SequenceAccount]:
        return {name: subscriptions[0].account for name, subscriptions in self.subscriptions.items()}

    @property
    def topic_of_source(self) -> dict[str, str]:
        """Topic behind each input, reply or call that the node's journal names."""
        return {subscription.source: subscription.topic for subscription in self._all_subscriptions()}

    def counts(self) -> dict[str, int]:
        """Return how many ticks, overruns, missed deadlines and messages lost by readers there were."""
        timers, events = self.timers.values(), self.events.items()
        return {
            "ticks": sum(end.tick_count for end in timers),
            "overruns": sum(end.overrun_count for end in timers),
            "missed_deadlines": sum(end.total for (kind, _), end in events if kind == "deadline"),
            "lost_by_readers": sum(out.lost_count for out in self.publishers.values()),
        }

    def run_count(self) -> int:
        handled = sum(subscription.account.received for subscription in self._all_subscriptions())
        timers, alarms = self.timers.values(), self.alarms.values()
        return handled + sum(end.tick_count for end in timers) + sum(end.tick_count for end in alarms)

    def latest(self) -> list[tuple[str, bytes]]:
        """Return the last message that each topic's reader has handled, the oldest first."""
        handled = [
            (*first.last, name)
            for name, (first, *_) in self.subscriptions.items()
            if first.last is not None and type(first) is Subscription
        ]
        handled.sort(key=lambda entry: entry[0])
        return [(name, encode_any(message)) for _, message, name in handled]

    def write_down(self) -> dict[str, Any]:
        return {
            "timers": {name: (end.k, end.due_ns) for name, end in self.timers.items()},
            "alarms": {name: end.due_ns for name, end in self.alarms.items() if end.due_ns is not None},
            "events": {end.name: end.total for end in self.events.values()},
            "calls": {end.name: copy.deepcopy(end.pending) for end in self.clients.values() if end.pending},
            "served": {server.name: server.keep() for server in self.action_servers.values()},
            "sent": {name: client.keep() for name, client in self.action_clients.items()},
            "consumed": {name: msgspec.structs.replace(counter) for name, counter in self.accounts.items()},
            "published": {name: out.sequence for name, out in self.publishers.items()},
            "idle": [name for name, out in self.publishers.items() if out.idle_until_next],
        }

    def resume(self, hand_over: HandOver) -> None:
        for name, timer in self.timers.items():
            timer.resume(hand_over.timers.get(name), hand_over.now_ns)
        for name, alarm in self.alarms.items():
            alarm.due_ns = hand_over.alarms.get(name)
        for event in self.events.values():
            event.resume(hand_over.events.get(event.name, 0))
        for call in self.clients.values():
            call.resume(hand_over.calls.get(call.name, []))
        for server in self.action_servers.values():
            server.resume(hand_over.served.get(server.name))
        for name, client in self.action_clients.items():
            client.resume(hand_over.sent.get(name, SentGoals()))
        for name, counter in hand_over.consumed.items():
            for subscription in self.subscriptions.get(name, []):
                subscription.account = msgspec.structs.replace(counter)
        for name, out in self.publishers.items():
            out.resume(hand_over.epoch, hand_over.published.get(name, 0), hand_over.history.get(name, []))
            out.idle_until_next = name in hand_over.idle


class _UnpublishedMessage(Message):
    """What the class does not publish: only the topic's sequence is known."""


def _answer(handler: Callable[..., Any], calls: RequestSubscription) -> Callable[..., None]:
    @functools.wraps(handler)
    def answer(node: Node, request: Message) -> None:
        calls.reply.reply(handler(node, request), *calls.current)

    return answer
