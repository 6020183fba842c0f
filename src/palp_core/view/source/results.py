"""The folder of a run's results as a source: its files, and nothing outside it."""

from __future__ import annotations

import contextlib
import itertools
import os
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

from palp_core.errors import GraphError, PalpError
from palp_core.graph.discovery.troubles import WARN, Trouble
from palp_core.graph.messages.topic import Topic
from palp_core.view.source.overview import Overview
from palp_core.view.source.protocol import Heard, Watch
from palp_core.view.source.sealed import sealed_within

KINDS = {
    ".html": "text/html; charset=utf-8",
    ".png": "image/png",
    ".svg": "image/svg+xml",
    **dict.fromkeys((".csv", ".json", ".txt", ".md", ".yaml", ".log"), "text/plain; charset=utf-8"),
}
MOST = 2000
MOST_BELOW = 50_000
"""Files and folders of a folder of results; one with more is a disk rather than a run."""


class ResultFile(msgspec.Struct, frozen=True):
    """A file, by its path from the folder."""

    name: str
    size_bytes: int


class ResultsSource:
    """The folder of a finished run.

    Args:
        folder: It.

    Raises:
        PalpError: There is none, or what is below it is too much to be looked at.
    """

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise PalpError(f"{folder}: no such folder; give a bag, or the folder of a run's results")
        self.folder = folder.resolve()
        below = (len(folders) + len(files) for _, folders, files in os.walk(self.folder))
        if any(count > MOST_BELOW for count in itertools.accumulate(below)):
            raise PalpError(
                f"{self.folder}: more than {MOST_BELOW} files are below it; give the folder of one run"
            )

    def overview(self) -> Overview:
        """Return what it is."""
        troubles = []
        if (sealed := sealed_within(self.folder)) is not None:
            text = "it is sealed: nothing of a blinded session is shown before it is unsealed"
            advice = f"palp session unseal {shlex.quote(str(sealed))} --reason '...'"
            troubles = [Trouble(str(sealed), WARN, text, advice)]
        return Overview(kind="results", title=self.folder.name, alive=False, troubles=troubles)

    def topics(self) -> list[Topic]:
        """Return none: messages are in bags."""
        return []

    def watch(self, topic: str) -> Watch:
        """Refuse.

        Raises:
            GraphError: Always.
        """
        raise GraphError(f"{self.folder} has no topic '{topic}': messages are in bags")

    def remembered(self, topics: Sequence[str]) -> Iterator[tuple[str, Heard]]:
        """Yield nothing: messages are in bags."""
        yield from ()

    def launch(self) -> dict[str, Any]:
        """Return nothing: bags say it."""
        return {}

    def close(self) -> None:
        """Let go."""

    def files(self) -> list[ResultFile]:
        """Return what can be shown, reports first."""
        found: list[ResultFile] = []
        if sealed_within(self.folder) is not None:
            return found
        for path in sorted(self.folder.rglob("*")):
            with contextlib.suppress(OSError, UnicodeEncodeError):  # gone meanwhile; a name that is no text
                if path.suffix in KINDS and path.is_file() and self._inside(path) is not None:
                    name = str(path.relative_to(self.folder))
                    name.encode()
                    found.append(ResultFile(name, path.stat().st_size))
            if len(found) == MOST:
                break
        return sorted(found, key=lambda one: (not one.name.endswith(".html"), one.name.count("/"), one.name))

    def path_of(self, name: str) -> Path | None:
        """Return a file by its path from the folder; None if there is none, or it leads out of the folder."""
        try:
            path = self._inside(self.folder / name)
            return None if sealed_within(self.folder) is not None else path
        except (OSError, ValueError, RuntimeError):
            return None

    def _inside(self, path: Path) -> Path | None:
        path = path.resolve()
        inside = path.is_relative_to(self.folder) and path.suffix in KINDS
        return path if inside and path.is_file() else None
