"""A graph that no other host can reach."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from palp_core.graph.messages.builtin import NodeHealth
    from palp_core.graph.network.join_protocol import JoinRequest


class NoDoor:
    """Stands where a :class:`~palp_core.graph.network.gateway_handle.Door` would."""

    endpoint = ""

    def __init__(self) -> None:
        self.guests: dict[str, JoinRequest] = {}
        self.health: dict[str, NodeHealth] = {}
        self.warnings: list[str] = []
        self.changed: Callable[[], None] = lambda: None

    def follow(self, loop: object) -> None:
        """Nothing happens here."""

    def speak(self, say: Callable[[str], None]) -> None:
        """Nothing is said."""

    def activate(self, start_ns: int) -> None:
        """Nobody is told."""

    def close(self, text: str, *, finished: bool) -> None:
        """Nobody is told."""
