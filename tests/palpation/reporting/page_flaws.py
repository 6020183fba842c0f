"""What every page owes its readers, whatever it is about."""

from __future__ import annotations

import itertools
import re
from html.parser import HTMLParser
from typing import Any

_VOID = {"meta", "img", "br", "hr", "link", "input"}
_HEADINGS = {f"h{level}": level for level in range(1, 7)}


class _Page(HTMLParser):
    """Collects what is checked of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[tuple[str, dict[str, str]]] = []
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.headings: list[tuple[int, dict[str, str]]] = []
        self.unscrolled: list[str] = []
        self.buried: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = {name: value or "" for name, value in attrs}
        self.tags.append((tag, found))
        if tag in _HEADINGS:
            self.headings.append((_HEADINGS[tag], found))
        if tag in ("table", "img") and not any(
            "scroll" in of.get("class", "").split() for _, of in self.open
        ):
            self.unscrolled.append(tag)
        if tag == "nav" and [name for name, _ in self.open] != ["html", "body", "main"]:
            self.buried.append(self.open[-1][0])
        if tag not in _VOID:
            self.open.append((tag, found))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop()[0] == tag, f"</{tag}> closes what it did not open"


def flaws(text: str) -> list[str]:
    """Return what is wrong with a page, in words."""
    page = _Page()
    page.feed(text)
    attributes = [found for _, found in page.tags]
    ids = [found["id"] for found in attributes if "id" in found]
    links = [(name, found[name]) for found in attributes for name in ("href", "src") if name in found]
    pictures = [found for tag, found in page.tags if tag == "img"]
    levels = [level for level, _ in page.headings]
    steps = itertools.pairwise(levels)
    wrong: dict[str, Any] = {
        "is not closed": [tag for tag, _ in page.open],
        "has no language": not any(tag == "html" and found.get("lang") == "en" for tag, found in page.tags),
        "has no title": not re.search(r"<title>[^<]*\w[^<]*</title>", text),
        "does not fit a phone": '<meta name="viewport" content="width=device-width, initial-scale=1">'
        not in text,
        "has not one first heading": levels.count(1) != 1 or levels[0] != 1,
        "skips a level of headings": [pair for pair in steps if pair[1] > pair[0] + 1],
        "has headings without id": [
            found for level, found in page.headings if level > 1 and not found.get("id")
        ],
        "has an id twice": sorted({one for one in ids if ids.count(one) > 1}),
        "leads to no id": [at for _, at in links if at.startswith("#") and at[1:] not in ids],
        "needs another file": [at for _, at in links if not at.startswith(("#", "data:"))],
        "has pictures without words": [one for one in pictures if not re.search(r"\w", one.get("alt", ""))],
        "is wider than a phone": page.unscrolled,
        "has its contents list within something else": page.buried,
        "has a table head without scope": [f for tag, f in page.tags if tag == "th" and "scope" not in f],
        "shows a value that is none": re.findall(r">\s*(?:None|nan|Undefined)\s*<", text),
    }
    return [f"the page {words}: {found}" for words, found in wrong.items() if found]
