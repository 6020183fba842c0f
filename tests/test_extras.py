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


WHEEL = "{url}/pyproject.toml"
"""Any file that is there."""


@pytest.mark.parametrize(
    ("kind", "there", "line"),
    [
        ({"dir_info": {}}, True, "pip install '{folder}[rig]'"),
        ({"dir_info": {"editable": True}}, True, "pip install --editable '{folder}[rig]'"),
        ({"archive_info": {}, "url": WHEEL}, True, f"pip install 'palp-core[rig] @ {WHEEL}'"),
        ({"archive_info": {}, "url": "https://lab/p.whl"}, False, "pip install 'palp-core[rig] @ https://lab/p.whl'"),
        ({"dir_info": {}}, False, "pip install 'scipy>=1.15' 'pyserial>=3.5'"),
        ({"archive_info": {}}, True, "pip install 'scipy>=1.15' 'pyserial>=3.5'"),
        ({"vcs_info": {}}, True, "pip install 'scipy>=1.15' 'pyserial>=3.5'"),
        (None, True, "pip install 'scipy>=1.15' 'pyserial>=3.5'"),
    ],
)  # fmt: skip
def test_an_extra_comes_from_where_palp_came_from_or_is_named_by_what_it_needs(
    kind: dict[str, Any] | None, there: bool, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "my palp"
    folder.mkdir()
    if there:
        (folder / "pyproject.toml").touch()
    url = folder.as_uri()
    origin = None if kind is None else json.dumps({"url": url, **kind}).replace("{url}", url)
    found = SimpleNamespace(read_text=lambda _: origin)
    needs = [
        "msgspec>=0.18",
        'scipy>=1.15; extra == "rig"',
        "pyserial>=3.5; extra == 'rig'",
        "rosbags; extra == 'rosbag'",
    ]
    monkeypatch.setattr("importlib.metadata.distribution", lambda _: found)
    monkeypatch.setattr("importlib.metadata.requires", lambda _: needs)
    assert extras.install_line("rig") == line.format(folder=folder, url=url)


def test_every_extra_of_this_install_is_named_by_what_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "_installed_from", lambda: "")
    for extra in {"rig", "emg", "rosbag", "lsl", "view"}:
        line = extras.install_line(extra)
        assert "palp-core" not in line
        assert ">=" in line


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
