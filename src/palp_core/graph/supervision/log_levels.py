"""From which level on what nodes log is shown, and what they log for that."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class LogLevels(NamedTuple):
    """Levels by node.

    Attributes:
        default: The least of what is shown.
        nodes: The same for nodes that have their own.
    """

    default: str = "warning"
    nodes: Mapping[str, str] = {}

    def shown(self, node: str) -> str:
        """Return the least of what is shown of a node.

        >>> LogLevels("error", {"policy": "debug"}).shown("policy")
        'debug'
        """
        return self.nodes.get(node, self.default)

    def logged(self, node: str) -> str:
        """Return the least that a node logs: ``info``, or ``debug`` where that is shown."""
        return "debug" if self.shown(node) == "debug" else "info"

    @property
    def least_logged(self) -> str:
        """The least that any node logs."""
        return "debug" if "debug" in (self.default, *self.nodes.values()) else "info"


def levels_of(given: str | LogLevels) -> LogLevels:
    """Return levels where one for all may be given by its name."""
    return LogLevels(given) if isinstance(given, str) else given
