"""What to record of a graph, and how: the flags of ``palp bag record`` as plain data."""

from __future__ import annotations

from typing import Literal

import msgspec


class RecordOptions(msgspec.Struct, frozen=True, kw_only=True):
    """What to record, and how.

    Attributes:
        out: The bag; in snapshot mode the first of them, the next are ``out-1``, ``out-2`` ...
        topics: Names; none and no ``regex``: all.
        max_bytes: Begin another file at this size; 0: never.
        max_duration_s: The same by time.
        snapshot_s: Keep so much in memory instead, and write it when asked; 0: record at once.
        from_start: The graph has yet to begin: every topic's first message must be in the bag.
    """

    out: str
    topics: list[str] = []
    regex: str | None = None
    exclude_regex: str | None = None
    max_bytes: int = 0
    max_duration_s: float = 0.0
    snapshot_s: float = 0.0
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    from_start: bool = False
