"""What a replay says of a node: how far it was the same, and where it was not."""

from __future__ import annotations

from typing import Any

import msgspec

from palp_core.graph.messages.message import decode_any


class Divergence(msgspec.Struct, frozen=True, kw_only=True):
    """The first output that differs, and what the node had consumed before it: last, and the last few."""

    topic: str
    sequence: int
    now_s: float
    what: str
    after: str
    inputs: list[str] = []


class NodeReplay(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one node.

    Attributes:
        consumed: Entries of its written order.
        compared: Outputs that were equal.
        uncovered: Outputs in the bag before the place where the replay could begin, or after the last of the
            written order (a node or a recorder that was killed takes the latest tenth of a second with it).
        clock_s: Time on the graph's clock that was replayed.
        wall_s: Time that it took.
        divergence: The first difference; None if there is none.
    """

    node: str
    consumed: int
    compared: int
    uncovered: int = 0
    clock_s: float
    wall_s: float
    divergence: Divergence | None


def differing_fields(recorded: bytes, replayed: bytes) -> str:
    """Say which fields of a message differ."""
    before, now = decode_any(dict[str, Any], recorded), decode_any(dict[str, Any], replayed)
    names = [name for name in before.keys() | now.keys() if before.get(name) != now.get(name)]
    return "; ".join(
        f"{name}: recorded {_shown(before.get(name))}, replayed {_shown(now.get(name))}"
        for name in sorted(names)
    )


def _shown(value: object) -> object:
    return f"<{len(value)} bytes>" if isinstance(value, bytes) else value
