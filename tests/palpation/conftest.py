"""Small synthetic records, as a session writes them; every page that a test writes is looked at."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from palp_core.palpation.reporting import html_page
from palp_core.whole_file import write_whole
from tests.palpation.reporting.page_flaws import flaws
from tests.support.sessions import blank_charts, record, strict_json, summary

__all__ = ["blank_charts", "record", "strict_json", "summary"]


@pytest.fixture(scope="session", autouse=True)
def _pages_are_readable() -> Iterator[None]:
    """Refuse a page that a phone, a screen reader or the contents list cannot use."""

    def look_and_write(path: Path, text: str) -> None:
        assert flaws(text) == []
        write_whole(path, text)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(html_page, "write_whole", look_and_write)
        yield
