"""A missing package is named with the command that installs it, which depends on where palp came from."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from palp_core import extras
from tests.support.palp import PATIENCE_S, ROOT, Palp


@pytest.fixture(autouse=True)
def fresh_origin() -> Iterator[None]:
    """Forget where palp was installed from, before and after."""
    extras._installed_from.cache_clear()
    yield
    extras._installed_from.cache_clear()


WHEEL = "{url}/pyproject.toml"
"""Any file that is there."""


@pytest.mark.parametrize(
    ("kind", "there", "line"),
    [
        ({"dir_info": {}}, True, "pip install '{folder}[emg]'"),
        ({"dir_info": {"editable": True}}, True, "pip install --editable '{folder}[emg]'"),
        ({"archive_info": {}, "url": WHEEL}, True, f"pip install 'palp-core[emg] @ {WHEEL}'"),
        ({"archive_info": {}, "url": "https://lab/p.whl"}, False, "pip install 'palp-core[emg] @ https://lab/p.whl'"),
        ({"dir_info": {}}, False, "pip install 'pyxdf>=1.16' 'pylsl>=1.16'"),
        ({"archive_info": {}}, True, "pip install 'pyxdf>=1.16' 'pylsl>=1.16'"),
        ({"vcs_info": {}}, True, "pip install 'pyxdf>=1.16' 'pylsl>=1.16'"),
        (None, True, "pip install 'pyxdf>=1.16' 'pylsl>=1.16'"),
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
        'pyxdf>=1.16; extra == "emg"',
        "pylsl>=1.16; extra == 'emg'",
        "pyarrow; extra == 'parquet'",
    ]
    monkeypatch.setattr("importlib.metadata.distribution", lambda _: found)
    monkeypatch.setattr("importlib.metadata.requires", lambda _: needs)
    assert extras.install_line("emg") == line.format(folder=folder, url=url)


COMMANDS = """
import contextlib, io, json, sys
from palp_core.__main__ import main
sys.modules.update(dict.fromkeys(json.loads(sys.argv[2])))
done = []
for line in json.loads(sys.argv[1]):
    sys.argv = ["palp", *line.split()]
    with contextlib.redirect_stderr(io.StringIO()) as error:
        try:
            main()
        except SystemExit as end:
            done.append((end.code, error.getvalue()))
print(json.dumps(done))
"""
NEEDS = {"view x": "view", "bridge foxglove": "foxglove", "devices probe lsl stream:=x": "emg"}


def test_a_command_that_needs_an_extra_reports_it_in_one_line(palp: Palp, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", COMMANDS, json.dumps(list(NEEDS)), json.dumps(list(extras._EXTRA_OF))],
        cwd=tmp_path, env=palp.environment, capture_output=True, text=True, check=False, timeout=PATIENCE_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for (line, extra), (status, printed) in zip(NEEDS.items(), json.loads(done.stdout), strict=True):
        assert status in (1, 2), line
        assert extras.install_line(extra) in printed, line
        assert len(printed.splitlines()) == 1, line


def test_every_extra_of_this_install_is_named_by_what_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "_installed_from", lambda: "")
    for extra in {"emg", "parquet", "view"}:
        line = extras.install_line(extra)
        assert "palp-core" not in line
        assert ">=" in line


def test_the_page_of_extras_lists_each_with_its_packages() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    page = (ROOT / "docs/reference/extras.md").read_text(encoding="utf-8")
    rows = {
        line.split("|")[1].strip(" `"): _letters(line) for line in page.splitlines() if line.startswith("| `")
    }
    assert set(rows) == set(project["optional-dependencies"])
    for extra, needs in project["optional-dependencies"].items():
        names = [re.split(r"[<>=\[;]", need)[0].strip() for need in needs]
        known = [name for name in names if name != "palp-core" and not name.startswith("ros-")]
        missing = [name for name in known if _letters(name) not in rows[extra]]
        assert missing == [] or extra in ("dev", "docs"), extra


def _letters(text: str) -> str:
    return text.lower().replace("-", "")
