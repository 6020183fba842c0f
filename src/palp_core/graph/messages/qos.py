"""Quality of service per port, in ROS 2's terms and with its request-versus-offered rules.

A policy is a field of :class:`Qos` and an entry of :data:`POLICIES`; launch files, checks and tools use
both. What keeps it is where messages are published (``node/publisher``), taken up (``node/subscription``) or
watched (``transport/receiver``).
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

import msgspec

EventKind = Literal[
    "deadline", "lifespan", "liveliness", "message_lost", "message_repeated", "call_timeout", "reader_overrun"
]

MAX_BLOCKING_MS = 1000.0
"""For how long ``publish()`` waits for a reader where nothing else is stated."""

MOST_UNREAD = 100_000
"""Messages that a node on the wall clock may have received and not taken up; the rest waits before it."""


class Qos(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a publisher offers or a reader requests; 0 means "none stated".

    Attributes:
        reliability: ``reliable``: what went missing is asked for again.
        durability: ``transient_local``: a late joiner gets the last ``depth`` messages.
        history: ``keep_all``: stated by a reader or its publisher, ``publish()`` waits while a ``reliable``
            reader on its host is ``depth`` messages behind, and the edge loses nothing. ``keep_last``: the
            publisher does not wait. In simulated time none has to.
        max_blocking_ms: Longest such wait; then ``publish()`` raises
            :class:`~palp_core.errors.PublishTimeout`. Where none is stated: :data:`MAX_BLOCKING_MS`.
        depth: Messages that the publisher keeps to fill gaps and greet late joiners; a ``best_effort`` reader
            holds no more than this unread, and drops the oldest.
        deadline_ms: Longest time between two messages.
        lifespan_ms: A message older than this is not handed over.
        liveliness: Who asserts that the publisher lives: its process, or each message (``manual_by_topic``).
        lease_ms: Longest silence before the publisher counts as dead.
    """

    reliability: Literal["best_effort", "reliable"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    history: Literal["keep_last", "keep_all"] = "keep_last"
    max_blocking_ms: float = 0.0
    depth: int = 10
    deadline_ms: float = 0.0
    lifespan_ms: float = 0.0
    liveliness: Literal["automatic", "manual_by_topic"] = "automatic"
    lease_ms: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a wrong policy where it is written, not where it is used."""
        for name, policy in POLICIES.items():
            value, words = getattr(self, name), _WORDS.get(name)
            if words is not None:
                if value not in words:
                    raise ValueError(f"qos {name} = {value!r}: give one of {', '.join(words)}")
            elif isinstance(value, bool) or not isinstance(value, int if name == "depth" else int | float):
                kind = "a whole number" if name == "depth" else "a number"
                raise ValueError(f"qos {name} = {value!r}: give {kind}")
            elif not policy.least <= value <= policy.most:
                raise ValueError(f"qos {name} = {value!r}: give {policy.least} to {policy.most}")

    @property
    def latched_depth(self) -> int:
        """How many last messages a late joiner is owed."""
        return self.depth if self.durability == "transient_local" else 0


class Policy(NamedTuple):
    """How both ends of an edge come to terms about one policy."""

    # returns why an offer cannot serve a request, or None
    conflict: Callable[[Any, Any], str | None] = lambda _requested, _offered: None
    # returns what holds between the two
    on_edge: Callable[[Any, Any], Any] = lambda requested, _offered: requested
    # returns what serves all inputs that read one topic; None: each input sees to its own
    shared: Callable[[list[Any]], Any] | None = None
    least: int = 0  # smallest number that can be stated
    # largest; times of over eleven days guard nothing, and depths of millions fill the memory
    most: int = 1_000_000_000
    event: EventKind | None = None  # the reader's event when a stated policy is not kept


def _needs(strong: str, what: str = "") -> Callable[[str, str], str | None]:
    """A reader that requests the stronger of two words is not served by the weaker."""

    def conflict(requested: str, offered: str) -> str | None:
        if requested != strong or offered == strong:
            return None
        return f"the reader asks for {strong}{what}, the publisher offers {offered}"

    return conflict


def _no_longer(what: str) -> Callable[[float, float], str | None]:
    """A reader that states a time is not served by a publisher that takes longer."""

    def conflict(requested_ms: float, offered_ms: float) -> str | None:
        if not requested_ms or offered_ms <= requested_ms:
            return None
        return f"the reader's {what} of {requested_ms:g} ms is shorter than the publisher's {offered_ms:g} ms"

    return conflict


def _strongest(strong: str) -> Callable[[list[str]], str]:
    return lambda asked: strong if strong in asked else asked[0]


def _either(strong: str) -> Callable[[str, str], str]:
    return lambda requested, offered: strong if strong in (requested, offered) else requested


def _shorter(requested_ms: float, offered_ms: float) -> float:
    return min((ms for ms in (requested_ms, offered_ms) if ms), default=0.0)


POLICIES: dict[str, Policy] = {
    "reliability": Policy(_needs("reliable"), shared=_strongest("reliable")),
    "durability": Policy(_needs("transient_local"), shared=_strongest("transient_local")),
    "history": Policy(on_edge=_either("keep_all"), shared=_strongest("keep_all")),
    "max_blocking_ms": Policy(on_edge=_shorter, shared=max, most=60_000),
    "depth": Policy(shared=max, least=1, most=1_000_000),
    "deadline_ms": Policy(_no_longer("deadline"), event="deadline"),
    "lifespan_ms": Policy(on_edge=_shorter, event="lifespan"),
    "lease_ms": Policy(_no_longer("lease"), event="liveliness"),
    "liveliness": Policy(_needs("manual_by_topic", " liveliness")),
}
"""By field of :class:`Qos`."""

_WORDS = {name: get_args(form) for name, form in get_type_hints(Qos).items() if get_origin(form) is Literal}


def incompatibility(requested: Qos, offered: Qos) -> str | None:
    """Return why a reader's request cannot be served by a publisher's offer, or None if it can."""
    if requested.history == "keep_all" and requested.reliability != "reliable":
        return "the reader asks for keep_all and is best_effort: no publisher waits for such a reader"
    for name, policy in POLICIES.items():
        reason = policy.conflict(getattr(requested, name), getattr(offered, name))
        if reason is not None:
            return reason
    return None


def on_edge(requested: Qos, offered: Qos) -> Qos:
    """Return what holds between a reader and a publisher: the request, with the shorter of two lifespans.

    Where one of them states ``keep_all``, it holds, but for a reader that is ``best_effort``.
    """
    if requested.reliability != "reliable":
        offered = msgspec.structs.replace(offered, history="keep_last")
    return Qos(
        **{name: p.on_edge(getattr(requested, name), getattr(offered, name)) for name, p in POLICIES.items()}
    )


def strictest(asked: list[Qos]) -> Qos:
    """Return what serves every input that reads the same topic."""
    return Qos(
        **{name: p.shared([getattr(qos, name) for qos in asked]) for name, p in POLICIES.items() if p.shared}
    )


def events_of(qos: Qos) -> list[EventKind]:
    """Return the events that can come of what is stated, each of which reports that it was not kept."""
    return [p.event for name, p in POLICIES.items() if p.event is not None and getattr(qos, name)]
