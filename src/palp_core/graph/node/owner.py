"""What the live ends of a node ask of whoever drives them."""

from typing import Protocol


class Owner(Protocol):
    """Time, and the way out, of publishers, clients, timers and events.

    Attributes:
        publishing: Whether the node may publish.
    """

    publishing: bool

    def now_ns(self) -> int:
        """Return the time of the present handler."""

    def resend(self, frame: bytes) -> None:
        """Send a frame again that was published before."""
