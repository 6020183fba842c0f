"""The documentation is in plain English: short sentences, short pages, short cells, no private words."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from docs.site.tables import MARK, again
from tests.support.palp import ROOT

LONGEST_SENTENCE, MEAN_SENTENCE, LONGEST_PAGE, LONGEST_CELL, LONGEST_ENTRY = 35, 18, 1500, 25, 20
ALL_PAGES = 28_000
"""Words of README and docs that are written by hand; fewer are better, so this number only falls."""
GENERATED = re.compile(r"<!-- generated: [^\n]+ -->\n\n(?:\|[^\n]*\n)+")
"""A table that a command prints; a test compares it with the code."""
BANNED = re.compile(
    r"\b(beside|anew|vouch\w*|reckon\w*|goes by|at work|in words|whoever|nobody|anybody|somebody)\b",
    re.IGNORECASE,
)
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


def prose(text: str) -> str:
    """Return the sentences: no code, headings, tables, comments, pictures, generated entries or targets."""
    text = re.sub(
        r"\A---\n.*?\n---\n|```.*?```|~~~.*?~~~|<!--.*?-->|!\[[^]]*\]\([^)]*\)", "", text, flags=re.DOTALL
    )
    text = re.sub(r"\]\([^)]*\)|[\[\]*]", "", re.sub(r"`[^`]*`", "code", text))
    kept = [line for line in text.splitlines() if not line.startswith(("#", "|", ":::"))]
    return re.sub(r"\n(?:[ \t]*(?:[-+:>]|\d+\.) )", "\n\n", "\n".join(["", *kept]))


def sentences(text: str) -> Iterator[list[str]]:
    for paragraph in re.split(r"\n\s*\n", prose(text)):
        for sentence in re.split(r"(?<=[.!?])[\s)]+", paragraph):
            words = re.findall(r"[\w'-]+", sentence)
            if words:
                yield words


def cells(text: str) -> Iterator[str]:
    for line in re.sub(r"```.*?```", "", text, flags=re.DOTALL).splitlines():
        if line.startswith("|"):
            yield from re.sub(r"\]\([^)]*\)", "]", line.replace(r"\|", "/")).strip("|").split("|")


def words_by_hand(text: str) -> int:
    text = GENERATED.sub("", text)
    return sum(map(len, sentences(text))) + sum(len(cell.split()) for cell in cells(text))


def problems(text: str) -> list[str]:
    """Return what a page must not have."""
    found = list(sentences(text))
    mean = sum(map(len, found)) / max(len(found), 1)
    wide = [cell for cell in cells(text) if len(cell.split()) > LONGEST_CELL]
    count = words_by_hand(text)
    return [
        *(
            f"a sentence of {len(one)} words: {' '.join(one[:8])} ..."
            for one in found
            if len(one) > LONGEST_SENTENCE
        ),
        *([f"sentences of {mean:.1f} words on average"] if mean > MEAN_SENTENCE else []),
        *([f"{count} words"] if count > LONGEST_PAGE else []),
        *(f"a cell of {len(cell.split())} words: {cell[:60]}" for cell in wide),
        *(f"the word '{word}'" for word in BANNED.findall(prose(text) + " ".join(cells(text)))),
    ]


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_a_page_is_plain_and_short(page: Path) -> None:
    assert problems(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "page", [page for page in PAGES if MARK.search(page.read_text(encoding="utf-8"))], ids=name
)
def test_a_table_of_data_or_code_is_what_they_make(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert text == again(text), "python -m docs.site.tables writes it again"


def test_all_pages_together_are_short() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    assert sum(words_by_hand(page.read_text(encoding="utf-8")) for page in pages) <= ALL_PAGES


def test_a_changelog_entry_is_short() -> None:
    entries = re.findall(r"^- (.+)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert [entry for entry in entries if len(entry.split()) > LONGEST_ENTRY] == []


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("word " * 36 + ".", "a sentence of 36 words"),
        (("word " * 19 + ". ") * 3, "sentences of 19.0 words"),
        (("word " * 10 + ". ") * 151, "1510 words"),
        ("| a | " + "word " * 26 + "|", "a cell of 26 words"),
        ("<!-- generated: palp x -->\n\n| a |\n" + ("| " + "word " * 20 + "|\n") * 80, ""),
        ("It stands beside the stage.", "the word 'beside'"),
        ("```\n" + "word " * 50 + "\n```\nFine.", ""),
    ],
)
def test_a_page_that_is_not_plain_is_found(text: str, problem: str) -> None:
    found = problems(text)
    assert found[0].startswith(problem) if problem else found == []
