"""Pages that continue on the site with what is generated from the code."""

from __future__ import annotations

from pathlib import Path

from docs.site.dictionary_page import dictionary_page
from docs.site.launch_page import launch_page
from docs.site.scene_page import scene_page
from docs.site.verbs_page import verbs_page

DOCS = Path(__file__).resolve().parents[1]
MADE = {
    "reference/launch_file.md": launch_page,
    "reference/scene_file.md": scene_page,
    "reference/verbs.md": verbs_page,
    "reference/data_dictionary.md": dictionary_page,
}
"""Functions that return the rest of a page, by its place below ``docs/``."""


def whole_page(place: str) -> str:
    """Return the page of a checkout, and the rest after it."""
    return (DOCS / place).read_text(encoding="utf-8") + MADE[place]()
