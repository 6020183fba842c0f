"""A study is three files: its module, its page's template, and its line in the catalogue."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path

import pytest

import palp_core
from palp_core.palpation.studies.catalogue import STUDIES, Study

SOURCE = Path(palp_core.__file__).parent
TEMPLATES = SOURCE / "palpation" / "reporting" / "templates" / "studies"


def template_of(one: Study) -> str:
    return f"{one.name.replace('-', '_')}.html"


@pytest.mark.parametrize("one", STUDIES.values(), ids=STUDIES)
def test_a_study_is_found_from_its_line_of_the_catalogue(one: Study) -> None:
    module_name, _, function = one.target.partition(":")
    module = importlib.import_module(module_name)
    taken = list(inspect.signature(getattr(module, function)).parameters)
    assert taken[:2] == ["out", "quick"]
    assert one.parallel == ({"workers", "dask"} <= set(taken))
    assert f'"studies/{template_of(one)}"' in Path(inspect.getsourcefile(module) or "").read_text("utf-8")


def test_nothing_else_has_to_know_of_a_study() -> None:
    assert {path.name for path in TEMPLATES.iterdir()} == {template_of(one) for one in STUDIES.values()}
    naming = {
        str(path.relative_to(SOURCE))
        for one in STUDIES.values()
        for path in SOURCE.rglob("*.py")
        if one.target.partition(":")[0] + ":" in path.read_text("utf-8")
    }
    assert naming == {"palpation/studies/catalogue.py"}
