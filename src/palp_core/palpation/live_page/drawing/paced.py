"""A drawing in the browser that is sent no more than the browser takes."""

from __future__ import annotations

from typing import Any

from nicegui.element import Element

MOST_UNDER_WAY = 3
"""What a browser has not taken yet: until it has, more is left out, however slow it is."""


class Paced(Element):  # type: ignore[misc]
    """A component whose methods answer ``taken`` with the number that they were given last."""

    def __init__(self) -> None:
        super().__init__()
        self._sent = self._taken = 0
        self.on("taken", self._take)

    @property
    def busy(self) -> bool:
        """Whether the browser has yet to take what it was given before."""
        return self._sent - self._taken >= MOST_UNDER_WAY

    def send(self, method: str, *given: Any) -> None:
        """Call a method in the browser."""
        self._sent += 1
        self.run_method(method, *given, self._sent)

    def _take(self, event: Any) -> None:
        """Note up to where the browser has come; whatever it says, it is at most what was sent."""
        if isinstance(event.args, int):
            self._taken = min(max(event.args, self._taken), self._sent)
