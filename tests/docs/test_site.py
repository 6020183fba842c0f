"""The documentation as a site: it builds without a warning, fetches nothing, and is complete."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import re
import zlib
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import pytest

from docs.site.scene_page import SECTIONS as SCENE_SECTIONS
from docs.site.units_page import quantities
from palp_core import units
from palp_core.cli.lazy import LazyGroup, load
from palp_core.cli.main import app
from palp_core.graph.description.launch_keys import SECTIONS
from palp_core.graph.description.tree_reader import fields_of
from palp_core.palpation.devices.contract import CONTRACTS, promises_of
from tests.support.palp import ROOT

pytestmark = pytest.mark.nightly
DOCS = ROOT / "docs"
FACES = (
    "palp_core",
    "palp_core.methods",
    "palp_core.palpation",
    "palp_core.palpation.devices",
    "palp_core.palpation.devices.emulator",
    "palp_core.palpation.mechanics",
    "palp_core.palpation.mechanics.contact",
)
"""Modules whose ``__all__`` is for others."""


class Addresses(HTMLParser):
    """Collects what a page has a browser fetch, and where its links lead."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: set[str] = set()
        self.links: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        for name in ("src", "srcset", "poster", "data") if tag != "a" else ():
            if text := given.get(name):
                self.fetched.add(text)
        if href := given.get("href"):
            fetched = tag == "link" and given.get("rel") not in ("canonical", "prev", "next", "license")
            (self.fetched if fetched else self.links).add(href)


def test_a_page_has_a_browser_fetch_nothing_from_elsewhere(site: Path) -> None:
    outside = re.compile(r"^(https?:)?//")
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 45
    for page in pages:
        found = Addresses()
        text = page.read_text(encoding="utf-8")
        found.feed(text)
        assert not {one for one in found.fetched if outside.match(one)}, page
        assert "default-src 'self'" in text, f"{page} may ask others"
    styles = "".join(file.read_text(encoding="utf-8") for file in site.rglob("*.css"))
    assert not re.findall(r"(?:url\(|@import )['\"]?(?:https?:)?//", styles)


def test_each_page_has_a_place_in_the_contents(site: Path) -> None:
    links = Addresses()
    links.feed((site / "index.html").read_text(encoding="utf-8"))
    there = {str(file.relative_to(DOCS).with_suffix(".html")) for file in DOCS.rglob("*.md")}
    assert there - links.links == set()


def text_of(site: Path, page: str) -> str:
    """Return a page's text without its marks."""
    html = (site / page).read_text(encoding="utf-8")
    plain = re.sub(r"<[^>]+>", "", html)
    return plain.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")


def test_every_key_of_a_launch_file_has_an_entry(site: Path) -> None:
    html = (site / "reference/launch_file.html").read_text(encoding="utf-8")
    for keys in SECTIONS.values():
        title, table = str(keys.__doc__).rstrip("."), fields_of(keys)
        section = html.split(f">{title}<a", 1)[1].split("<h2", 1)[0]
        missing = [name for name in table if f"<td><code>{name}</code></td>" not in section]
        assert missing == [], title


def test_every_key_of_a_scene_has_an_entry_with_a_sentence(site: Path) -> None:
    html = (site / "reference/scene_file.html").read_text(encoding="utf-8")
    for title, kind in SCENE_SECTIONS.values():
        section = html.split(f">{title}<a", 1)[1].split("<h2", 1)[0]
        missing = [name for name in kind.__annotations__ if f"<td><code>{name}</code></td>" not in section]
        assert missing == [], title
        assert "<td></td>\n</tr>" not in section, f"{title}: a key without a sentence"


def verbs() -> Iterator[tuple[str, object]]:
    """Yield every verb with its command."""
    kind = app.info.cls
    assert isinstance(kind, type)
    assert issubclass(kind, LazyGroup)
    for name, verb in kind.verbs.items():
        command = load(name, verb)
        inner = getattr(command, "commands", None)
        if inner is None:
            yield f"palp {name}", command
            continue
        for word, one in inner.items():
            lazily = isinstance(command, LazyGroup)
            yield f"palp {name} {word}", load(word, command.verbs[word]) if lazily else one


def test_every_verb_and_flag_has_an_entry(site: Path) -> None:
    html = (site / "reference/verbs.html").read_text(encoding="utf-8")
    sections = dict(re.findall(r"<h[23] id=\"[\w-]+\">(palp[^<]*)<a(.*?)(?=<h[23] |</article>)", html, re.S))
    found = list(verbs())
    assert len(found) > 80
    missing = {path for path, _ in found} - set(sections)
    for path, command in found:
        for parameter in command.params:  # type: ignore[attr-defined]
            if (
                parameter.param_type_name == "option"
                and not parameter.hidden
                and "--help" not in parameter.opts
            ):
                long = max(parameter.opts, key=len)
                if long not in sections.get(path, ""):
                    missing.add(f"{path} {long}")
    assert missing == set()


def inventory(site: Path) -> set[str]:
    """Return every name of Python's that the site has an entry for."""
    raw = (site / "objects.inv").read_bytes().split(b"\n", 4)[4]
    return {line.split()[0] for line in zlib.decompress(raw).decode().splitlines()}


def test_what_a_flag_takes_is_written_as_it_is_typed(site: Path) -> None:
    text = text_of(site, "reference/verbs.html")
    assert "--probation N|Ss" in text
    assert "\\" not in text.split("palp launch", 1)[1].split("palp run", 1)[0]


def imported_in_docs() -> set[str]:
    """Return what the pages' own examples import of palp_core."""
    found = set()
    for page in (*DOCS.rglob("*.md"), ROOT / "README.md"):
        for block in re.findall(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), re.M | re.S):
            for node in ast.walk(ast.parse(block)):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("palp_core"):
                    found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def home_of(name: str) -> str:
    """Return the name under which a class or function was made, as entries have it; of a value its word."""
    module, _, word = name.rpartition(".")
    home = importlib.import_module(module)
    if hasattr(home, "__path__") and importlib.util.find_spec(name):
        return word  # a module of a package
    found = getattr(home, word)
    made = inspect.isclass(found) or inspect.isfunction(found)
    return f"{found.__module__}.{found.__qualname__}" if made else word


def test_every_public_name_has_an_entry(site: Path) -> None:
    entries = inventory(site)
    words = {entry.rpartition(".")[2] for entry in entries}
    public = {f"{face}.{name}" for face in FACES for name in importlib.import_module(face).__all__}
    assert len(public) > 90
    units_there = {f"palp_core.units.{name}" for name, *_ in quantities()}
    examples = {name for name in imported_in_docs() if not name.startswith("palp_core.workspace.")}
    missing = [
        name for name in sorted((public | examples) - units_there) if home_of(name) not in entries | words
    ]
    assert missing == []


def test_every_promise_of_a_driver_has_an_entry(site: Path) -> None:
    text = text_of(site, "reference/device_promises.html")
    promises = {promise for kind in CONTRACTS for promise in promises_of(kind)}
    assert len(promises) > 10
    assert {promise for promise in promises if promise not in text} == set()


def test_every_unit_has_an_entry(site: Path) -> None:
    text = text_of(site, "reference/python_units.html")
    quantities_there = [name for name, *_ in quantities()]
    aliases = [
        name for name in vars(units) if name[0].isupper() and name not in ("Annotated", "Meta", "NDArray")
    ]
    assert set(aliases) - set(quantities_there) == {"Float64Array"}
    assert [name for name in quantities_there if name not in text] == []
