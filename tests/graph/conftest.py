"""What the tests of the graph share."""

from __future__ import annotations

from tests.support.bags import bag, kit

__all__ = ["bag", "kit"]
