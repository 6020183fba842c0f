"""Packages that an install may lack, and the line that installs them."""

from __future__ import annotations

import functools
import json
from pathlib import Path

DISTRIBUTION = "palp-core"
"""The package; ``palp`` is the command, and on the public index another project."""

_EXTRA_OF = {
    "rclpy": "ros2",
    "pyarrow": "parquet",
    "pylsl": "emg",
    "pyxdf": "emg",
    "distributed": "dask",
    "foxglove": "foxglove",
    "nicegui": "view",
}
"""The extra that brings a module."""


def install_line(extra: str) -> str:
    """Return the command that installs an extra: from where palp came from, else what the extra needs."""
    if source := _installed_from():
        return f"pip install {source.replace('{}', f'[{extra}]')}"
    return "pip install " + " ".join(f"'{need}'" for need in _needs(extra))


@functools.cache
def _installed_from() -> str:
    """Return what the installer takes, with ``{}`` for the extras; "" if that is not known or gone."""
    from importlib.metadata import PackageNotFoundError, distribution
    from urllib.parse import unquote, urlsplit

    try:
        origin = json.loads(distribution(DISTRIBUTION).read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, OSError, ValueError):
        origin = {}
    url = str(origin.get("url", ""))
    path = Path(unquote(urlsplit(url).path))
    if "archive_info" in origin and (path.is_file() or not url.startswith("file:")):
        return f"'{DISTRIBUTION}{{}} @ {url}'"
    if "dir_info" not in origin or not (path / "pyproject.toml").is_file():
        return ""
    return f"--editable '{path}{{}}'" if origin["dir_info"].get("editable") else f"'{path}{{}}'"


def _needs(extra: str) -> list[str]:
    """Return the requirements of an extra."""
    from importlib.metadata import PackageNotFoundError, requires

    try:
        lines = requires(DISTRIBUTION) or []
    except PackageNotFoundError:
        lines = []
    needs = [line.partition(";") for line in lines if f"extra == '{extra}'" in line.replace('"', "'")]
    return [need.strip() for need, _, _ in needs] or [f"{DISTRIBUTION}[{extra}]"]


def advice(missing: ImportError) -> str:
    """Return what to do about a module that is not installed; "" if no extra of palp brings it."""
    module = (missing.name or "").partition(".")[0]
    extra = _EXTRA_OF.get(module) if isinstance(missing, ModuleNotFoundError) else None
    return f"{module} is not installed; type: {install_line(extra)}" if extra else ""
