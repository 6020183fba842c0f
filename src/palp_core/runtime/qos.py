"""Quality of service per port, in ROS 2's terms and with its request-versus-offered rules."""

from __future__ import annotations

from typing import Literal

import msgspec

__all__ = ["Qos", "incompatibility"]


class Qos(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a publisher offers or a reader requests; 0 means "none stated"."""

    reliability: Literal["best_effort", "reliable"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: int = 10
    deadline_ms: float = 0.0
    lifespan_ms: float = 0.0


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
    return None
