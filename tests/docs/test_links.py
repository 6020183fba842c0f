"""Each link within the documentation leads to a page and a heading that exist."""

from __future__ import annotations

import re
from pathlib import Path

from tests.support.palp import ROOT

LINK = re.compile(r"\]\((?!\w+:)([^)#\s]*)(?:#([^)\s]+))?\)")
"""A link to a file or a heading, not to another host."""
MADE = ROOT / "docs" / "reference"
"""Whose pages get headings with the site: from the code, or from the source's docstrings."""


def headings(page: Path) -> set[str]:
    """Return the anchors that MkDocs gives to the headings of a page."""
    words = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    plain = [re.sub(r"\]\([^)]*\)|[^\w\s-]", "", one).strip().lower() for one in words]
    return {re.sub(r"[-\s]+", "-", one) for one in plain}


def broken_links(page: Path, text: str) -> list[str]:
    found = []
    for file, anchor in LINK.findall(re.sub(r"```.*?```", "", text, flags=re.DOTALL)):
        target = (page.parent / file).resolve() if file else page
        made = MADE in target.parents
        if not target.exists() or (
            anchor and not made and target.suffix == ".md" and anchor not in headings(target)
        ):
            found.append(f"{page.relative_to(ROOT)}: {file}#{anchor}")
    return found


def test_each_link_leads_somewhere() -> None:
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")]
    assert len(pages) > 20
    assert [one for page in pages for one in broken_links(page, page.read_text(encoding="utf-8"))] == []


def test_a_link_that_leads_nowhere_is_found() -> None:
    text = "[a](index.md) [b](nowhere.md) [c](index.md#no-such-heading) [d](#neither) [e](https://x.org/y)"
    assert len(broken_links(ROOT / "docs" / "index.md", text)) == 3
