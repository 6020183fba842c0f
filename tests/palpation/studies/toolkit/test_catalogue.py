"""A study is three files: its module, its page's template, and its line in the catalogue."""

from __future__ import annotations

import importlib
import inspect

from palp_core.palpation.studies.catalogue import OPTIONS, STUDIES


def test_a_study_is_found_from_its_line_of_the_catalogue() -> None:
    for name, one in STUDIES.items():
        module_name, _, function = one.target.partition(":")
        module = importlib.import_module(module_name)
        taken = list(inspect.signature(getattr(module, function)).parameters)
        assert taken[:2] == ["out", "quick"], name
        assert {*taken[2:]} <= {*OPTIONS, "seed"}, name
        assert f'"studies/{name.replace("-", "_")}.html"' in inspect.getsource(module), name
