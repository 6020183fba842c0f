"""How to get what an install lacks: the words follow where palp was installed from."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from palp_core import extras
from tests.support.palp import ROOT


@pytest.fixture(autouse=True)
def anew() -> Iterator[None]:
    """Look where palp was installed from anew, before and after."""
    extras._installed_from.cache_clear()
    yield
    extras._installed_from.cache_clear()


@pytest.mark.parametrize(
    ("kind", "there", "line"),
    [
        ({"dir_info": {}}, True, "pip install '{folder}[rig]'"),
        ({"dir_info": {"editable": True}}, True, "pip install --editable '{folder}[rig]'"),
        ({"dir_info": {}}, False, "pip install 'palp-core[rig]'"),
        ({"archive_info": {}}, True, "pip install 'palp-core[rig]'"),
        (None, True, "pip install 'palp-core[rig]'"),
    ],
)
def test_an_extra_comes_from_the_checkout_that_palp_was_installed_from(
    kind: dict[str, Any] | None, there: bool, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "my palp"
    folder.mkdir()
    if there:
        (folder / "pyproject.toml").touch()
    said = None if kind is None else json.dumps({"url": folder.as_uri(), **kind})
    found = SimpleNamespace(read_text=lambda _: said)
    monkeypatch.setattr("importlib.metadata.distribution", lambda _: found)
    assert extras.install_line("rig") == line.format(folder=folder)


def test_the_page_of_extras_has_each_with_what_it_brings() -> None:
    told = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    page = (ROOT / "docs/reference/extras.md").read_text(encoding="utf-8")
    rows = {line.split("|")[1].strip(" `"): line for line in page.splitlines() if line.startswith("| `")}
    assert set(rows) == set(told["optional-dependencies"])
    for extra, needs in told["optional-dependencies"].items():
        names = [re.split(r"[<>=\[;]", need)[0].strip() for need in needs]
        known = [name for name in names if name != "palp-core" and not name.startswith("ros-")]
        missing = [name for name in known if name.lower().replace("-", "") not in _letters(rows[extra])]
        assert missing == [] or extra in ("dev", "docs"), extra


def _letters(text: str) -> str:
    return text.lower().replace("-", "")
