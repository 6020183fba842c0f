"""Pages from templates: one base with one style sheet, one file of macros; a page needs no other file.

The words of a page are in its template, ``templates/NAME.html``; Python hands in values, and the filters
below write them. A value that a template names and does not get is an error. Headings get ids, to which a
contents list leads; ``glossary.csv`` explains the words that a page uses and a reader cannot guess.
"""

from __future__ import annotations

import base64
import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from html import unescape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from palp_core.palpation.reporting import charts
from palp_core.palpation.reporting.charts import Chart
from palp_core.whole_file import write_whole

if TYPE_CHECKING:
    from jinja2 import Environment

_HEADING = re.compile(r"<h([23])(?: id=\"([^\"]*)\")?>(.*?)</h\1>", re.DOTALL)
_TAG = re.compile(r"<[^>]*>")


@dataclass(frozen=True)
class Picture:
    name: str
    title: str
    caption: str
    alt: str  # what it shows, for readers who do not see it
    svg: bytes
    files: tuple[str, ...] = ()  # names of its files, where it has any

    @property
    def base64(self) -> str:
        return base64.b64encode(self.svg).decode("ascii")


def picture(chart: Chart, folder: Path | None = None) -> Picture:
    """Return a chart for a page; with a folder, save it there as PNG, SVG and CSV, too."""
    if folder is None:
        return Picture(chart.name, chart.title, chart.caption, chart.alt, charts.image(chart, "svg"))
    charts.save(chart, folder)
    files = tuple(f"{chart.name}.{form}" for form in ("png", "svg", "csv"))
    svg = (folder / f"{chart.name}.svg").read_bytes()
    return Picture(chart.name, chart.title, chart.caption, chart.alt, svg, files)


def write_page(path: Path, template: str, **values: Any) -> Path:
    """Write a page from a template, ``studies/paper.html`` say, and its values.

    The page appears under its name only when complete; its folder is made if missing.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, _environment().get_template(template).render(values))
    return path


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    found = Environment(
        loader=PackageLoader("palp_core.palpation.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    found.filters |= {
        "outlined": outlined,
        "glossary": words_of,
        "number": format,
        "percent": percent,
        "span": span,
        "points": points,
        "plain": plain,
        "spaced": spaced,
    }
    return found


class Outline(NamedTuple):
    """A page's body before its first heading and from it on; id and words of the headings of level 2."""

    lead: str
    rest: str
    sections: list[tuple[str, str]]


def outlined(body: str) -> Outline:
    """Return the outline of a page's body, which is HTML; every heading has an id that no other has."""
    taken: set[str] = set()
    sections = []

    def name(heading: re.Match[str]) -> str:
        level, given, words = heading.groups()
        plain = _TAG.sub("", words).strip()
        letters = re.sub(r"[^a-z0-9]+", "-", re.sub(r"&[a-z]+;|&#\d+;", " ", plain.lower()))
        wanted = found = given or letters.strip("-") or "part"
        number = 1
        while found in taken:
            number += 1
            found = f"{wanted}-{number}"
        taken.add(found)
        if level == "2":
            sections.append((found, plain))
        return f'<h{level} id="{found}">{words}</h{level}>'

    text = _HEADING.sub(name, body)
    first = _HEADING.search(text)
    at = first.start() if first else len(text)
    return Outline(text[:at], text[at:], sections)


@cache
def glossary() -> list[tuple[re.Pattern[str], str, str]]:
    """Return pattern, name and meaning of each word; one with capitals is meant as it is: EMG."""
    with Path(__file__).with_name("glossary.csv").open(encoding="utf-8", newline="") as file:
        _, *lines = csv.reader(file)
    return [
        (re.compile(rf"(?<!\w)(?:{of})(?!\w)", 0 if re.search("[A-Z]", of) else re.IGNORECASE), word, meaning)
        for of, word, meaning in lines
    ]


def words_of(body: str) -> list[tuple[str, str]]:
    """Return name and meaning of the words that a page's HTML shows, in the order of the alphabet."""
    text = unescape(_TAG.sub(" ", body))
    used = [(word, meaning) for pattern, word, meaning in glossary() if pattern.search(text)]
    return sorted(used, key=lambda entry: entry[0].lower())


def percent(share: float, digits: int = 1) -> str:
    """Return a share in per cent.

    >>> percent(0.6667)
    '66.7 %'
    """
    return f"{100.0 * share:.{digits}f} %"


def span(ends: Sequence[float], form: str = ".1f", scale: float = 100.0) -> str:
    """Return an interval of shares in per cent, without the sign.

    >>> span((0.5, 0.75))
    '50.0 to 75.0'
    """
    low, high = ends
    return f"{scale * low:{form}} to {scale * high:{form}}"


def points(difference: float) -> str:
    """Return a difference of shares in percentage points.

    >>> points(-0.015)
    '-1.5'
    """
    return f"{100.0 * difference:+.1f}"


def plain(value: Any, digits: int = 6, nothing: str = "(none)") -> str:
    """Return any value for people; ``digits`` count for floats, ``nothing`` is for no value.

    >>> plain([0.1, "a"]), plain(""), plain(1 / 3, 4)
    ('0.1, a', '(none)', '0.3333')
    """
    if isinstance(value, float):
        return f"{value:.{digits}g}"
    if isinstance(value, list | tuple):
        return ", ".join(plain(one, digits, nothing) for one in value)
    return nothing if value in ("", None) else str(value)


def spaced(name: str) -> str:
    """Return a name as words: ``fixed_best`` as ``fixed best``."""
    return name.replace("_", " ")
