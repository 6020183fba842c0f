"""What the live ends of a node ask of whoever drives them."""

from collections.abc import Callable
from typing import Protocol


class Owner(Protocol):
    """Time, and the way out, of publishers, clients, timers and events.

    Attributes:
        publishing: Whether the node may publish.
    """

    publishing: bool

    @property
    def send_pieces(self) -> Callable[[bytes, bytes, memoryview, bytes], None] | None:
        """Takes the topic and the pieces of a large message; None: it is sent whole."""

    def now_ns(self) -> int:
        """Return the time of the present handler."""

    def resend(self, frame: bytes) -> None:
        """Send a frame again that was published before."""
