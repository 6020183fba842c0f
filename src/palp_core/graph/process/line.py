"""Base of the messages on a private line between two of palp's own processes."""

from __future__ import annotations

import msgspec


class Line(msgspec.Struct, frozen=True, array_like=True, tag=True):
    """Base of what travels on a line."""
