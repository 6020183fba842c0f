"""The outline of a page: its headings get ids, and the contents list leads to them."""

from __future__ import annotations

import re
from dataclasses import dataclass

_HEADING = re.compile(r"<h([23])(?: id=\"([^\"]*)\")?>(.*?)</h\1>", re.DOTALL)
_TAG = re.compile(r"<[^>]*>")


@dataclass(frozen=True)
class Heading:
    """A heading of the second level: its id, and its words as HTML."""

    id: str
    words: str


@dataclass(frozen=True)
class Outline:
    """A page's body in two parts, with what the contents list needs."""

    lead: str  # what stands before the first heading
    rest: str  # from it on; every heading has an id that no other has
    sections: tuple[Heading, ...]  # the headings of the second level


def outlined(body: str) -> Outline:
    """Return the outline of a page's body, which is HTML."""
    taken: set[str] = set()
    sections = []

    def name(heading: re.Match[str]) -> str:
        level, given, words = heading.groups()
        plain = _TAG.sub("", words).strip()
        found = _free(given or _slug(plain), taken)
        taken.add(found)
        if level == "2":
            sections.append(Heading(found, plain))
        return f'<h{level} id="{found}">{words}</h{level}>'

    text = _HEADING.sub(name, body)
    first = _HEADING.search(text)
    at = first.start() if first else len(text)
    return Outline(text[:at], text[at:], tuple(sections))


def _slug(words: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", re.sub(r"&[a-z]+;|&#\d+;", " ", words.lower())).strip("-") or "part"


def _free(name: str, taken: set[str]) -> str:
    """Return the name, or the name with the least number that makes it no other's."""
    found, number = name, 1
    while found in taken:
        number += 1
        found = f"{name}-{number}"
    return found
