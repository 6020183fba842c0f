"""Quality of service per port, in ROS 2's terms and with its request-versus-offered rules."""

from __future__ import annotations

from typing import Literal

import msgspec


class Qos(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a publisher offers or a reader requests; 0 means "none stated".

    Attributes:
        reliability: ``reliable``: what went missing is asked for again.
        durability: ``transient_local``: a late joiner gets the last ``depth`` messages.
        depth: Messages that the publisher keeps to fill gaps and greet late joiners; a ``best_effort`` reader
            holds no more than this unread, and drops the oldest.
        deadline_ms: Longest time between two messages.
        lifespan_ms: A message older than this is not handed over.
        liveliness: Who asserts that the publisher lives: its process, or each message (``manual_by_topic``).
        lease_ms: Longest silence before the publisher counts as dead.
    """

    reliability: Literal["best_effort", "reliable"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: int = 10
    deadline_ms: float = 0.0
    lifespan_ms: float = 0.0
    liveliness: Literal["automatic", "manual_by_topic"] = "automatic"
    lease_ms: float = 0.0


def incompatibility(requested: Qos, offered: Qos) -> str | None:
    """Return why a reader's request cannot be served by a publisher's offer, or None if it can."""
    if requested.reliability == "reliable" and offered.reliability == "best_effort":
        return "the reader asks for reliable, the publisher offers best_effort"
    if requested.durability == "transient_local" and offered.durability == "volatile":
        return "the reader asks for transient_local, the publisher offers volatile"
    if requested.deadline_ms and offered.deadline_ms > requested.deadline_ms:
        return (
            f"the reader's deadline of {requested.deadline_ms:g} ms is shorter than the publisher's "
            f"{offered.deadline_ms:g} ms"
        )
    if requested.lease_ms and offered.lease_ms > requested.lease_ms:
        return (
            f"the reader's lease of {requested.lease_ms:g} ms is shorter than the publisher's "
            f"{offered.lease_ms:g} ms"
        )
    if requested.liveliness == "manual_by_topic" and offered.liveliness == "automatic":
        return "the reader asks for manual_by_topic liveliness, the publisher offers automatic"
    return None


def on_edge(requested: Qos, offered: Qos) -> Qos:
    """Return what holds between a reader and a publisher: the request, with the shorter of two lifespans."""
    lifespans = [ms for ms in (requested.lifespan_ms, offered.lifespan_ms) if ms]
    return msgspec.structs.replace(requested, lifespan_ms=min(lifespans, default=0.0))


def strictest(asked: list[Qos]) -> Qos:
    """Return what serves every input that reads the same topic."""
    return Qos(
        reliability="reliable" if any(q.reliability == "reliable" for q in asked) else "best_effort",
        durability="transient_local" if any(q.durability == "transient_local" for q in asked) else "volatile",
        depth=max(q.depth for q in asked),
    )
