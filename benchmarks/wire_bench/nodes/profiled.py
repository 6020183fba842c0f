"""Profile a node from the inside, as its process runs."""

from __future__ import annotations

import cProfile
from pathlib import Path

__all__ = ["Profile"]


class Profile:
    """A profile that begins at activation and is written at the end; none if ``path`` is None."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._profile = cProfile.Profile()

    def begin(self) -> None:
        """Begin."""
        if self._path is not None:
            self._profile.enable()

    def end(self) -> None:
        """End and write."""
        if self._path is not None:
            self._profile.disable()
            self._profile.dump_stats(self._path)
