"""Small synthetic records, written as a session writes them."""

from __future__ import annotations

from tests.support.sessions import record, strict_json, summary

__all__ = ["record", "strict_json", "summary"]
