"""Pages that are generated from the code."""

from __future__ import annotations

from docs.site.dictionary_page import dictionary_page
from docs.site.launch_page import launch_page
from docs.site.promises_page import promises_page
from docs.site.scene_page import scene_page
from docs.site.units_page import units_page
from docs.site.verbs_page import verbs_page

MADE = {
    "reference/launch_file.md": launch_page,
    "reference/scene_file.md": scene_page,
    "reference/python_units.md": units_page,
    "reference/device_promises.md": promises_page,
    "reference/verbs.md": verbs_page,
    "reference/data_dictionary.md": dictionary_page,
}
"""Their functions, by their place below ``docs/``."""
