"""What a node and the live ends of its ports may ask of the executor that runs them."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import numpy as np


class PublisherContext(Protocol):
    """Time, and the way out."""

    publishing: bool

    def now_ns(self) -> int:
        """Return the time of the present handler, on the graph's clock."""

    def resend(self, frame: bytes) -> None:
        """Send a frame again that was published before."""


class NodeContext(PublisherContext, Protocol):
    """A node's place in its graph."""

    name: str
    epoch: int
    node: Any
    rng: np.random.Generator
    log: logging.Logger

    def finish(self, exit_code: int) -> None:
        """End the node's work."""
